#!/bin/sh
# Replace every replica by a new one, one after the other, without losing a request:
#   docker/rolling-restart.sh [-f FILE]... [-p PROJECT]
# The words go to Compose; without any they are -f docker/compose.scale.yaml. A new image or new
# settings come into effect: build or edit first. Needs room for one replica more.
set -eu
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || set -- -f docker/compose.scale.yaml
if docker compose version >/dev/null 2>&1; then
    compose() { docker compose "$@"; }
else
    compose() { docker-compose "$@"; }
fi

# Waits until a container's own check says so; fails where it ends or never does.
wait_until_healthy() {
    for _ in $(seq 120); do
        case $(docker inspect --format '{{.State.Status}} {{.State.Health.Status}}' "$1") in
            "running healthy") return ;;
            running*) sleep 0.5 ;;
            *) break ;;
        esac
    done
    echo "the new replica $1 does not become ready: the old ones are left as they are" >&2
    docker logs --tail 20 "$1" >&2
    exit 1
}

old=$(compose "$@" ps -q neuralmusic)
more=$(($(echo "$old" | wc -w) + 1))
for replica in $old; do
    before=$(compose "$@" ps -q neuralmusic)
    compose "$@" up -d --no-deps --no-recreate --scale neuralmusic=$more neuralmusic
    for new in $(compose "$@" ps -q neuralmusic); do
        case $before in *"$new"*) ;; *) wait_until_healthy "$new" ;; esac
    done
    sleep 1 # until the proxy knows it, too
    docker stop "$replica" >/dev/null
    docker rm "$replica" >/dev/null
done
