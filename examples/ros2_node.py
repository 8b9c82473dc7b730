"""A ROS 2 node: directions of sound as ``geometry_msgs/PoseArray`` and as JSON.

Tested with stand-ins for rclpy and the messages, **not on ROS**: tell us what your robot says.

    python examples/ros2_node.py --ros-args -p array:=respeaker-usb-4mic-v2 -p device:=ReSpeaker

Publishes, for every result,

- ``~/directions`` (``geometry_msgs/PoseArray``): one pose per active source at the array's origin,
  whose x axis points to the source (REP-103, counter-clockwise, radians inside), stamped with the
  capture time of the audio, so that tf gives the robot's pose of that moment;
- ``~/results`` (``std_msgs/String``): the result's JSON, pausing sources included.

Parameters: ``url``, ``array``, ``device`` (a part of its name, or its number), ``frame_id``,
``channel_map`` (``1,2,3,4``; empty where there are as many channels as microphones), and ``topic``:
with the name of a topic of ``std_msgs/Int16MultiArray`` (interleaved samples of
``topic_channels`` channels at ``topic_rate`` Hz) nothing is recorded here. Where the service has
keys, the variable ``NEURALMUSIC_KEY`` holds one.
"""

from __future__ import annotations

import math
import os
import threading
from typing import Any

import rclpy
from geometry_msgs.msg import Pose, PoseArray
from rclpy.node import Node
from std_msgs.msg import Int16MultiArray, String

from neuralmusic import Reconnecting, StreamClient
from neuralmusic.errors import DoaError
from neuralmusic.protocol.server_messages import Result, StreamWarning
from neuralmusic.sources.microphone import Microphone

NANOSECONDS = 1_000_000_000
WAIT_S = 60.0
"""Seconds that the node waits for the service at its start"""
PARAMETERS = {
    "url": "http://127.0.0.1:8000",
    "array": "respeaker-usb-4mic-v2",
    "device": "",
    "frame_id": "mic_link",
    "channel_map": "",
    "topic": "",
    "topic_rate": 16_000,
    "topic_channels": 4,
}


class SoundDirections(Node):
    """Streams one microphone array to the service and publishes where the sounds come from."""

    def __init__(self) -> None:
        super().__init__("sound_directions")
        for name, default in PARAMETERS.items():
            self.declare_parameter(name, default)
        self._directions = self.create_publisher(PoseArray, "~/directions", 10)
        self._results = self.create_publisher(String, "~/results", 10)
        self._stopping = threading.Event()
        self._microphone = None if self._value("topic") else Microphone(self._value("device"))
        self._stream = StreamClient(
            self._value("url"),
            array=self._value("array"),
            audio=self._audio(),
            key=os.environ.get("NEURALMUSIC_KEY"),  # a parameter could be read by every node
            wait_s=WAIT_S,
            **self._channel_map(),
        ).open()
        self._threads = [threading.Thread(target=self._publish_all)]
        if self._microphone is None:
            self.create_subscription(Int16MultiArray, self._value("topic"), self._heard, 10)
        else:
            self._threads.append(threading.Thread(target=self._record))
        for thread in self._threads:
            thread.start()

    def destroy_node(self) -> None:
        """Stop recording and end the session."""
        self._stopping.set()
        self._stream.close()
        for thread in self._threads:
            thread.join()
        super().destroy_node()

    def _value(self, name: str) -> Any:
        return self.get_parameter(name).value

    def _audio(self) -> dict[str, Any]:
        if self._microphone is not None:
            return self._microphone.audio
        return {
            "encoding": "pcm_s16le",
            "sample_rate": self._value("topic_rate"),
            "channels": self._value("topic_channels"),
            "header": "seq_time",
        }

    def _channel_map(self) -> dict[str, Any]:
        chosen = self._value("channel_map")
        return {"channel_map": [int(channel) for channel in chosen.split(",")]} if chosen else {}

    def _heard(self, message: Int16MultiArray) -> None:
        """The topic's audio; it was captured when it came, since the message has no stamp."""
        self._stream.send(message.data)  # an array.array, which has the buffer protocol

    def _record(self) -> None:
        try:
            self._microphone.feed(self._stream.send, self._stopping)
        except DoaError as error:
            self.get_logger().error(error.detail)

    def _publish_all(self) -> None:
        try:
            for event in self._stream:
                self._publish(event)
        except DoaError as error:
            self.get_logger().error(error.detail)

    def _publish(self, event: Any) -> None:
        match event:
            case Result():
                self._directions.publish(self._poses(event))
                self._results.publish(String(data=event.model_dump_json(exclude_none=True)))
            case StreamWarning():
                self.get_logger().warning(f"{event.code}: {event.detail}")
            case Reconnecting():
                self.get_logger().warning(f"{event.reason}: again in {event.delay_s:.1f} s")

    def _poses(self, result: Result) -> PoseArray:
        poses = PoseArray()
        poses.header.frame_id = self._value("frame_id")
        captured_ns = result.capture_time_ns or self.get_clock().now().nanoseconds
        poses.header.stamp.sec, poses.header.stamp.nanosec = divmod(captured_ns, NANOSECONDS)
        poses.poses = [towards(s.azimuth_deg) for s in result.sources if s.active]
        return poses


def towards(azimuth_deg: float) -> Pose:
    """At the origin, turned about z so that x points to the source."""
    pose = Pose()
    half = math.radians(azimuth_deg) / 2
    pose.orientation.z, pose.orientation.w = math.sin(half), math.cos(half)
    return pose


def main() -> None:
    rclpy.init()
    node = SoundDirections()
    try:
        rclpy.spin(node)
    except KeyboardInterrupt:
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
