"""Time from ``docker run`` to the first 200 of /readyz.

``python tests/bench/cold_start.py --runs 9`` with an engine and the image ``neuralmusic``; further
words go to ``docker run``: ``-- --cpus 1``.
"""

from __future__ import annotations

import argparse
import http.client
import statistics
import subprocess
import time

COMMAND = ("docker", "run", "-d", "--read-only", "--tmpfs", "/tmp", "-p", "127.0.0.1:0:8000")
LOOK_S = 0.02


def output(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


def ready(port: int) -> bool:
    """Whether the service is ready; a refused connection means no."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=5)
    try:
        connection.request("GET", "/readyz")
        return connection.getresponse().status == 200
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


def cold_start(image: str, words: list[str]) -> float:
    """Seconds of one start; the container is gone afterwards."""
    began = time.monotonic()
    container = output(*COMMAND, *words, image)
    try:
        port = int(output("docker", "port", container, "8000").rpartition(":")[2])
        while not ready(port):
            time.sleep(LOOK_S)
        return time.monotonic() - began
    finally:
        output("docker", "rm", "-f", container)


def main() -> None:
    """Print every start, and the median."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--image", default="neuralmusic")
    parser.add_argument("words", nargs="*", help="of docker run")
    asked = parser.parse_args()
    times = sorted(cold_start(asked.image, asked.words) for _ in range(asked.runs))
    print(
        " ".join(f"{seconds:.2f}" for seconds in times), f"median {statistics.median(times):.2f} s"
    )


if __name__ == "__main__":
    main()
