"""Work on a stream of inputs in a few threads, the results in the inputs' order."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

InputT = TypeVar("InputT")
ResultT = TypeVar("ResultT")


def in_order(
    work: Callable[[InputT], ResultT], inputs: Iterable[InputT], threads: int
) -> Iterator[tuple[InputT, ResultT]]:
    """Every input with its result; at most one input per thread is ahead of them.

    With one thread nothing is ahead: the caller's own thread does the work.
    """
    if threads == 1:
        for each in inputs:
            yield each, work(each)
        return
    with ThreadPoolExecutor(threads) as pool:
        ahead: deque[tuple[InputT, Future[ResultT]]] = deque()
        for each in inputs:
            ahead.append((each, pool.submit(work, each)))
            if len(ahead) > threads:
                first, future = ahead.popleft()
                yield first, future.result()
        for first, future in ahead:
            yield first, future.result()
