"""The pipelines of the streams that one worker computes."""

from __future__ import annotations

import logging

from neuralmusic.errors import UNEXPECTED, DoaError
from service.inference.registry import BundleRegistry
from service.streaming.opening import open_stream
from service.streaming.pipeline import StreamPipeline
from service.streaming.work import (
    Advance,
    Advanced,
    Check,
    Checked,
    Close,
    Failed,
    Open,
    Outcome,
    StreamOpened,
    Work,
)

log = logging.getLogger(__name__)


class StreamHost:
    """Does the jobs of sessions; a ``Check`` may run in a thread beside another job."""

    def __init__(self, registry: BundleRegistry) -> None:
        self._registry = registry
        self._pipelines: dict[str, StreamPipeline] = {}

    def perform(self, work: Work) -> Outcome | None:
        """The outcome of one job; None where nothing comes back."""
        try:
            match work:
                case Open():
                    return self._open(work)
                case Advance():
                    return self._advance(work)
                case Check():
                    pipeline = self._pipelines.get(work.session)
                    return Checked(tuple(pipeline.diagnostics.check()) if pipeline else ())
                case Close():
                    self._pipelines.pop(work.session, None)
                    return None
        except DoaError as error:
            return Failed(error)
        except Exception:
            log.exception("the stream failed", extra={"session_id": work.session})
            return Failed(DoaError(UNEXPECTED))

    def _open(self, work: Open) -> StreamOpened:
        pipeline, opened = open_stream(work, self._registry)
        self._pipelines[work.session] = pipeline
        return opened

    def _advance(self, work: Advance) -> Advanced:
        pipeline = self._pipelines[work.session]
        if work.calibrate_s is not None:
            pipeline.calibrate(work.calibrate_s)
        step = pipeline.step(work.pieces, work.output, final=work.final, poses=work.poses)
        return Advanced(
            clock=pipeline.clock,
            estimate=step.estimate,
            check_due=pipeline.diagnostics.due(),
            calibrated=step.calibrated,
            calibration_error=step.calibration_error,
        )
