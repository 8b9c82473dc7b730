"""A session's poses until the audio before them is localized."""

from __future__ import annotations

import math
from collections import deque

from neuralmusic.errors import InvalidMessage
from neuralmusic.protocol.client_messages import AudioFormat
from neuralmusic.protocol.client_messages import Pose as PoseMessage
from service.doa.pose import MOST_POSES, Pose, Rotation
from service.streaming.intake import Intake

STALE_S = 1.0
"""Seconds of audio after the newest pose before a warning"""
POSE_STALE = (
    f"no pose came for {STALE_S:g} s of audio: the last one is held; if the robot turns, "
    "directions are wrong until it sends poses again"
)


class WaitingPoses:
    """The poses that came since the last job, each with the sample frames received before it.

    A job gets the poses that came amid or before its audio, so that results depend on the order of
    the messages and not on how fast they are worked off.
    """

    def __init__(self, audio: AudioFormat, intake: Intake) -> None:
        self._audio = audio
        self._intake = intake
        self._waiting: deque[tuple[int, PoseMessage]] = deque(maxlen=MOST_POSES)
        self._newest: float | None = None
        """Seconds of the stream"""
        self._warned = False

    def add(self, message: PoseMessage) -> None:
        """Take a pose.

        Raises
        ------
        InvalidMessage
            If it has a capture time and the audio has none.
        """
        if message.capture_time_ns is not None and self._audio.header != "seq_time":
            raise InvalidMessage(
                "a pose with capture_time_ns needs audio with headers (header seq_time): give t, "
                "or neither"
            )
        if message.t is None and message.capture_time_ns is None:
            now = self._intake.position / self._audio.sample_rate
            message = message.model_copy(update={"t": now})
        self._waiting.append((self._intake.received, message))

    def take(self) -> tuple[Pose, ...]:
        """The poses before or amid the audio that was taken from the intake."""
        taken = []
        while self._waiting and self._waiting[0][0] < max(self._intake.removed, 1):
            message = self._waiting.popleft()[1]
            time = message.t
            if message.capture_time_ns is not None:
                time = self._intake.time_of(message.capture_time_ns)
            if time is not None:
                taken.append(Pose(time, rotation(message)))
                self._newest = time if self._newest is None else max(self._newest, time)
                self._warned = False
        return tuple(taken)

    def stale(self, now: float) -> bool:
        """Whether to warn, once, that no pose came for long before a stream time in seconds."""
        if self._newest is None or now - self._newest <= STALE_S or self._warned:
            return False
        self._warned = True
        return True


def rotation(message: PoseMessage) -> Rotation:
    """The rotation of a pose message."""
    if message.quaternion_xyzw is None:
        angles = (message.yaw_deg, message.pitch_deg, message.roll_deg)
        return Rotation.of_angles(*map(math.radians, angles))
    x, y, z, w = message.quaternion_xyzw
    length = math.hypot(x, y, z, w)
    return Rotation(w / length, x / length, y / length, z / length)
