"""The computation of a stream: pieces of PCM in, estimates of the present out."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
import soxr

from neuralmusic.errors import InvalidOption, NoiseCalibrationFailed
from neuralmusic.protocol.client_messages import AudioFormat, OutputOptions
from neuralmusic.protocol.framing import NANOSECONDS
from neuralmusic.protocol.methods import Hemisphere, Method
from neuralmusic.protocol.server_messages import WhyNoSource
from service.audio.pcm import decode_pcm
from service.doa.array import MicrophoneArray
from service.doa.diagnostics.running import RunningDiagnostics
from service.doa.orientation import Orientation
from service.doa.orientation import turned as turned_spectrum
from service.doa.pose import STILL, Pose, PoseTrack, Rotation
from service.doa.silence import SILENCE
from service.doa.stft import Stft, StreamingStft
from service.doa.tracking import Detection, Track, Tracker
from service.doa.types import ComplexArray, FloatArray
from service.doa.whitening import NoiseCovariance, NoiseEstimator
from service.inference.bundle import Bundle
from service.inference.results import WindowEstimate
from service.inference.stream import stream_localizer_of
from service.inference.weights import BLOCK_FRAMES
from service.streaming.buffer import Piece
from service.streaming.clock import StreamClock
from service.streaming.history import LAST_TIME

RESAMPLING = "MQ"
"""Quality of soxr: 6 ms of delay where its HQ takes 33 ms"""
LONG_GAP = 0.25
"""Seconds without audio after which the window starts afresh; shorter gaps are closed over"""


@dataclass(frozen=True, slots=True)
class StreamPlan:
    """The array, method, model and options of a stream."""

    audio: AudioFormat
    array: MicrophoneArray
    channel_map: tuple[int, ...]
    method: Method
    bundle: Bundle | None
    stft: Stft
    noise: NoiseCovariance | None = None
    """The robot's own noise, to be removed"""
    hemisphere: Hemisphere = "both"
    """Side of the horizontal plane on which sources are"""


class Estimate(NamedTuple):
    """Directions at one moment of the stream, in the array's frame.

    Of the frame ``world`` that is the array's where the robot is not turned.
    """

    t_start: float
    """Seconds of stream time"""
    t_end: float
    """Seconds of stream time"""
    capture_time_ns: int | None
    tracks: tuple[Track, ...]
    """Most confident first"""
    spectrum: FloatArray
    """(A,)"""
    why_no_source: WhyNoSource | None
    arrived: float | None
    """Time of the session's clock at which the last of its audio arrived; None before any did"""
    pose: Rotation | None = None
    """The robot's rotation into the world's frame, where it sends poses"""
    sphere: FloatArray | None = None
    """(36, 72) image of the sphere, where it is asked for and elevations are told"""


@dataclass(frozen=True, slots=True)
class Step:
    """The outcome of one step."""

    estimate: Estimate | None
    """The estimate, where one was due"""
    calibrated: NoiseCovariance | None = None
    """The learnt noise, in the step that completes the calibration"""
    calibration_error: str | None = None


class StreamPipeline:
    """One stream's resampler, STFT, localizer, tracker and diagnostics."""

    def __init__(self, plan: StreamPlan) -> None:
        self._plan = plan
        self._rate = plan.stft.sample_rate
        self._ratio = plan.audio.sample_rate / self._rate
        """Sample frames of the stream per sample of the analysis"""
        self._tracker = Tracker()
        self._poses = PoseTrack()
        self.diagnostics = RunningDiagnostics(plan.audio.sample_rate, plan.channel_map, plan.array)
        """Checks of the channels; steps feed them, another thread may read them"""
        self._calibration: _Calibration | None = None
        self._position = 0
        """Sample frames of the stream taken in so far, missing ones included"""
        self._offset = 0.0
        """Samples of stream time that are missing before this position"""
        self._arrived: float | None = None
        self._captured: tuple[int, int] | None = None
        """A position of the stream and its capture time"""
        self._reported = -1.0
        """Stream time of the last estimate in samples"""
        self._samples = 0
        """Samples taken in since the beginning, or since audio was forgotten"""
        self._begin(plan.noise)

    def _begin(self, noise: NoiseCovariance | None) -> None:
        """Forget all audio, keep the tracks and the time; an exception changes nothing."""
        plan = self._plan
        microphones = plan.array.num_microphones
        self._localizer = stream_localizer_of(
            plan.method, plan.bundle, plan.array, plan.stft, noise, plan.hemisphere
        )
        self._noise = noise
        # The audio that a resampler still holds is lost; its time is not.
        self._offset = self._position / self._ratio
        self._samples = 0
        self._resampler = None
        if plan.audio.sample_rate != self._rate:
            self._resampler = soxr.ResampleStream(
                plan.audio.sample_rate, self._rate, microphones, "float32", RESAMPLING
            )
        self._stft = StreamingStft(plan.stft, microphones)
        self._frames = 0
        self._fresh: list[ComplexArray] = []
        """Spectra since the last estimate"""
        self._energies: deque[tuple[int, float]] = deque()
        """Numbers of samples and their summed squares, for the latest window of audio"""

    @property
    def stream_samples(self) -> float:
        """Stream time up to which the analysis has audio, in samples at its rate."""
        return self._offset + self._samples

    @property
    def window_s(self) -> float:
        """Most seconds of audio behind an estimate."""
        stft = self._plan.stft
        return stft.num_samples(self._localizer.window_frames) / self._rate

    @property
    def clock(self) -> StreamClock:
        """The position of the stream."""
        return StreamClock(self._rate, self._ratio, self.stream_samples, self._reported)

    def step(
        self,
        pieces: Sequence[Piece],
        output: OutputOptions,
        *,
        final: bool = False,
        poses: Sequence[Pose] = (),
    ) -> Step:
        """Take in audio; give an estimate where one is due, or for ``final`` in any case.

        Parameters
        ----------
        pieces : sequence of Piece
            Pieces in order, at most the ``frames_needed`` of the clock.
        poses : sequence of Pose
            The robot's rotations, in any order. From the first one on tracks are the world's.
        """
        self._turn(poses, output)
        due = self.clock.due(output.interval_ms)
        self._take(pieces)
        wanted = self.stream_samples >= due or (final and self.stream_samples > self._reported)
        estimate = self._estimate(output) if wanted else None
        if self._calibration is None or not self._calibration.complete:
            return Step(estimate)
        estimator, self._calibration = self._calibration.estimator, None
        try:
            noise = estimator.finish()
            self._begin(noise)
        except (NoiseCalibrationFailed, InvalidOption) as error:
            return Step(estimate, calibration_error=error.detail)
        return Step(estimate, noise)

    def calibrate(self, seconds: float) -> None:
        """Learn the noise from the next ``seconds`` of audio; never call it during a step."""
        plan = self._plan
        self._calibration = _Calibration(NoiseEstimator(plan.array, plan.stft), seconds)

    def _take(self, pieces: Sequence[Piece]) -> None:
        """Take in pieces; consecutive ones without a gap are joined."""
        run: list[Piece] = []
        for piece in pieces:
            if piece.position > self._position:
                self._analyse(run)
                run = []
                self._skip(piece.position - self._position)
            run.append(piece)
            self._position = piece.position + len(piece.data) // self._plan.audio.frame_bytes
        self._analyse(run)

    def _skip(self, frames: int) -> None:
        """Let time pass for missing audio."""
        missing = frames / self._ratio
        if missing > LONG_GAP * self._rate:
            self._begin(self._noise)
        self._offset += missing

    def _analyse(self, pieces: Sequence[Piece]) -> None:
        """Decode, resample and transform consecutive pieces."""
        if not pieces:
            return
        audio, last = self._plan.audio, pieces[-1]
        self._arrived = last.arrived
        if last.capture_time_ns is not None:
            self._captured = (last.position, last.capture_time_ns)
        data = b"".join(piece.data for piece in pieces)
        samples = decode_pcm(data, audio.encoding, audio.channels, self._plan.channel_map)
        self.diagnostics.add(samples)
        if audio.encoding == "pcm_f32le":
            samples = np.nan_to_num(samples)  # the diagnostics got them unchanged
        if self._resampler is not None:
            samples = self._resampler.resample_chunk(np.ascontiguousarray(samples.T)).T
        self._samples += samples.shape[1]
        self._energies.append((samples.shape[1], float(np.vdot(samples, samples))))
        spectra = self._stft.push(samples)
        if spectra.shape[-1]:
            self._fresh.append(spectra)
            if self._calibration is not None:
                self._calibration.estimator.add(spectra)

    def _turn(self, poses: Sequence[Pose], output: OutputOptions) -> None:
        """Take in poses; the first ones bring the tracks into the world's frame."""
        first = not self._poses
        for pose in poses:
            self._poses.add(pose)
        if first and poses:
            self._tracker.turn(self._heading(self.stream_samples / self._rate, output))

    def _heading(self, time: float, output: OutputOptions, width: float = 0.0) -> Rotation:
        """The array's rotation into the world's frame at a time in seconds."""
        mounted = Rotation.of_angles(math.radians(output.yaw_deg))
        turned = self._poses.around(time, width) if width else self._poses.at(time)
        return turned.after(mounted)

    def _estimate(self, output: OutputOptions) -> Estimate:
        estimate, why = self._localize(output)
        orientation = Orientation.of_degrees(output.yaw_deg, output.exclude_deg)
        heard = [s for s in estimate.sources if not orientation.excludes(s.azimuth)]
        if estimate.sources and not heard:
            why = "excluded"
        end = self.stream_samples
        self._reported = end
        t_end = end / self._rate
        found = [Detection(s.azimuth, s.confidence, s.elevation) for s in heard]
        if estimate.heading is not None:
            found = [detection.turned(estimate.heading) for detection in found]
        followed = self._tracker.update(found, t_end)
        turned = None
        if self._poses:
            turned = self._heading(t_end, output).inverse
            followed = tuple(track.turned(turned) for track in followed)
        # A track may coast into an excluded sector.
        tracks = [track for track in followed if not orientation.excludes(track.azimuth)]
        # At most the known number of sources: those heard now before those that may return.
        tracks.sort(key=lambda track: (not track.active, -track.confidence))
        tracks = tracks[: output.num_sources or output.max_sources]
        tracks.sort(key=lambda track: -track.confidence)
        result = Estimate(
            t_start=max(0.0, t_end - self.window_s),
            t_end=t_end,
            capture_time_ns=self._capture_time(end),
            tracks=tuple(tracks),
            spectrum=estimate.spectrum,
            why_no_source=None if tracks else why,
            arrived=self._arrived,
            sphere=estimate.sphere if "sphere" in output.include else None,
        )
        return result if turned is None else self._in_frame(result, estimate, turned, output)

    def _in_frame(
        self, result: Estimate, estimate: WindowEstimate, turned: Rotation, output: OutputOptions
    ) -> Estimate:
        """A result, so far in the array's frame of the moment, in the frame that is asked for."""
        mounted = Rotation.of_angles(math.radians(output.yaw_deg))
        pose = turned.inverse.after(mounted.inverse)
        way = STILL
        if output.frame == "world":
            way = mounted.inverse.after(turned.inverse)
        result = result._replace(tracks=tuple(t.turned(way) for t in result.tracks), pose=pose)
        if estimate.heading is None:
            return result
        yaw = way.after(turned).after(estimate.heading).yaw
        sphere = None if result.sphere is None else turned_spectrum(result.sphere, yaw)
        return result._replace(spectrum=turned_spectrum(result.spectrum, yaw), sphere=sphere)

    def _localize(self, output: OutputOptions) -> tuple[WindowEstimate, WhyNoSource]:
        """The latest window's estimate, and why there would be no source."""
        if self._fresh:
            spectra = np.concatenate(self._fresh, axis=-1)
            self._frames += spectra.shape[-1]
            self._fresh.clear()
            self._localizer.push(spectra)
        if self._frames == 0:
            return self._localizer.nothing, "warming_up"
        if self._power() < SILENCE:
            return self._localizer.nothing, "silence"
        most = min(output.max_sources, self._plan.array.num_microphones - 1)
        headings = partial(self._frame_heading, output=output) if self._poses else None
        estimate = self._localizer.estimate(output.num_sources, most, headings)
        return estimate, "unconfirmed" if estimate.sources else "no_direction"

    def _frame_heading(self, frame: float, output: OutputOptions) -> Rotation:
        """The array's mean rotation into the world's frame over the block around an STFT frame."""
        stft = self._plan.stft
        middle = self._offset + frame * stft.hop + stft.n_fft / 2
        width = BLOCK_FRAMES * stft.hop / self._rate
        return self._heading(middle / self._rate, output, width)

    def _power(self) -> float:
        """Mean square of the latest window of audio."""
        samples = sum(count for count, _ in self._energies)
        while samples - self._energies[0][0] > self.window_s * self._rate:
            samples -= self._energies.popleft()[0]
        total = sum(energy for _, energy in self._energies)
        return total / (max(samples, 1) * self._plan.array.num_microphones)

    def _capture_time(self, end: float) -> int | None:
        if self._captured is None:
            return None
        position, captured = self._captured
        frames = end * self._ratio - position
        captured += round(frames * NANOSECONDS / self._plan.audio.sample_rate)
        return max(-LAST_TIME, min(captured, LAST_TIME))


@dataclass(frozen=True, slots=True)
class _Calibration:
    estimator: NoiseEstimator
    seconds: float

    @property
    def complete(self) -> bool:
        return self.estimator.seconds >= self.seconds
