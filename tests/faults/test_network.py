"""The network between robots and the service is cut for a while: packets vanish, nobody is told."""

from __future__ import annotations

import asyncio
import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Callable

import pytest
from bench.fleet import Robot, fleet, until
from bench.namespace import FAR, Namespace, usable
from bench.proxy import Proxy, installed
from bench.served import Footprint, Served

pytestmark = [
    pytest.mark.faults,
    pytest.mark.skipif(not usable(), reason="network namespaces need root, ip and iptables"),
]

ROBOTS = 4
AFTER = 20
IDLE_S = 30.0
"""The service's own timeout, and its default"""
SLACK_S = 10.0


def running(namespace: Namespace, service: Served) -> int:
    """How many streams run, asked within the namespace, where no cable is cut."""
    ask = f"import urllib.request as r; print(r.urlopen('{service.url}/sessions').read().decode())"
    command = [*namespace.within, sys.executable, "-ISc", ask]
    said = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    return sum(each["state"] == "running" for each in said["sessions"])


@pytest.mark.parametrize("cut_s", [3.0, 40.0])
@pytest.mark.parametrize("way", ["direct", "proxy"])
def test_network_cut(figures: Callable[..., None], way: str, cut_s: float) -> None:
    ended: list[float] = []

    async def scenario(
        namespace: Namespace, service: Served, url: str
    ) -> tuple[list[Robot], float, Footprint, Footprint]:
        before = service.footprint()
        async with fleet(url, ROBOTS) as robots:
            namespace.cut()
            began = time.monotonic()
            with contextlib.suppress(TimeoutError):
                await until(lambda: running(namespace, service) == 0, "sessions end", cut_s)
                ended.append(time.monotonic() - began)
            await asyncio.sleep(began + cut_s - time.monotonic())
            namespace.mend()
            mended = time.monotonic()
            await until(
                lambda: all(sum(h.arrived > mended for h in r.heard) >= AFTER for r in robots),
                "all robots hear again",
                90,
            )
            assert not any(robot.failure for robot in robots)
        await until(
            lambda: service.footprint().sockets <= before.sockets, "nothing is left over", IDLE_S
        )
        return robots, mended, before, service.footprint()

    with contextlib.ExitStack() as stack:
        namespace = stack.enter_context(Namespace())
        if way == "proxy":
            if installed() is None:
                pytest.skip("haproxy is not installed")
            service = stack.enter_context(Served("--stream-workers", "1", within=namespace.within))
            url = stack.enter_context(Proxy([service.port], FAR, namespace.within)).url
        else:
            service = stack.enter_context(
                Served("--stream-workers", "1", "--host", FAR, within=namespace.within)
            )
            url = service.url
        robots, mended, before, after = asyncio.run(scenario(namespace, service, url))
        assert "Traceback" not in service.log
    lost_s = max(robot.lost_s(mended - cut_s) for robot in robots)
    again = max(robot.outage_s(mended) for robot in robots)
    figures(
        f"Network cut for {cut_s:g} s, "
        f"{'between robots and HAProxy' if way == 'proxy' else 'robots at the service directly'}, "
        f"{ROBOTS} robots",
        new_sessions=f"{sum(robot.cut for robot in robots)}",
        sessions_ended=f"{ended[0]:.0f} s after the cut" if ended else "not within the cut",
        hear_again=f"{again:.1f} s after it is mended",
        audio_without_result=f"{lost_s:.1f} s at most a robot",
        left_over=f"{after.sockets - before.sockets} sockets, "
        f"{after.threads - before.threads} threads",
    )
    if cut_s > IDLE_S + SLACK_S / 2:
        assert ended
        assert ended[0] <= IDLE_S + SLACK_S
    assert after.sockets <= before.sockets
    assert after.files <= before.files
    assert after.threads <= before.threads + 1
