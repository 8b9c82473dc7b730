#!/bin/sh
# Replace every replica, one after the other, without losing a request:
#   docker/rolling-restart.sh [-f FILE]... [-p PROJECT]
# The arguments go to Compose; the default is -f docker/compose.scale.yaml. New replicas use the
# current image and settings: build or edit first. Needs room for one more replica.
set -eu
cd "$(dirname "$0")/.."
[ $# -gt 0 ] || set -- -f docker/compose.scale.yaml
if docker compose version >/dev/null 2>&1; then
    compose() { docker compose "$@"; }
else
    compose() { docker-compose "$@"; }
fi

# Waits until a container is healthy; fails if it ends or never gets healthy.
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
    sleep 1 # until the proxy knows the new replica
    docker stop "$replica" >/dev/null
    docker rm "$replica" >/dev/null
done
