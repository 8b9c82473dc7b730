"""The examples do what they say, against the service itself and stand-ins for ROS."""

from __future__ import annotations

import array
import importlib.util
import json
import math
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
import soundfile
from scripted_service import TIMEOUT_S, Peer, ScriptedService, result

from neuralmusic.protocol.framing import HEADER
from neuralmusic.protocol.server_messages import StreamWarning
from service.doa.array import MicrophoneArray

EXAMPLES = Path(__file__).parents[2] / "examples"


def load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_robot_turns_to_the_talker(
    real_service: str,
    square: MicrophoneArray,
    plane_waves: Any,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = tmp_path / "talk.wav"
    soundfile.write(path, plane_waves(square, [60], seconds=2.0).T, 16_000)
    example = load("robot_loop")
    turned: list[float] = []
    monkeypatch.setattr(example, "turn", turned.append)
    example.main(str(path), square.name, real_service)
    assert turned[-1] == pytest.approx(60, abs=5)
    assert capsys.readouterr().out == "sources heard: 1\n"


class Message:
    """A ROS message whose fields come into being when they are used."""

    def __init__(self, **fields: Any) -> None:
        self.__dict__.update(fields)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        self.__dict__[name] = Message()
        return self.__dict__[name]


class Publisher:
    def __init__(self) -> None:
        self.messages: list[Any] = []
        self.published = threading.Event()

    def publish(self, message: Any) -> None:
        self.messages.append(message)
        self.published.set()


class Node:
    """What the example needs of rclpy's."""

    parameters: dict[str, Any] = {}  # noqa: RUF012

    def __init__(self, name: str) -> None:
        self.declared: dict[str, Any] = {}
        self.publishers_: dict[str, Publisher] = {}
        self.subscribed: dict[str, Callable[[Any], None]] = {}
        self.logged: list[str] = []

    def declare_parameter(self, name: str, default: Any) -> None:
        self.declared[name] = default

    def get_parameter(self, name: str) -> Any:
        return SimpleNamespace(value=self.parameters.get(name, self.declared[name]))

    def create_publisher(self, kind: type, topic: str, depth: int) -> Publisher:
        return self.publishers_.setdefault(topic, Publisher())

    def create_subscription(self, kind: type, topic: str, call: Any, depth: int) -> None:
        self.subscribed[topic] = call

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.logged.append, error=self.logged.append)

    def destroy_node(self) -> None:
        self.logged.append("destroyed")


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> None:
    modules = {
        "rclpy": {},
        "rclpy.node": {"Node": Node},
        "geometry_msgs": {},
        "geometry_msgs.msg": {"Pose": Message, "PoseArray": Message},
        "std_msgs": {},
        "std_msgs.msg": {"String": Message, "Int16MultiArray": Message},
    }
    for name, content in modules.items():
        module = ModuleType(name)
        module.__dict__.update(content)
        monkeypatch.setitem(sys.modules, name, module)


def test_the_ros_node_publishes_poses_stamped_with_the_capture_time(
    ros: None, service_of: Callable[..., ScriptedService], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[bytes] = []

    def script(peer: Peer) -> None:
        peer.begin()
        heard.append(peer.hear())
        captured = result(1, 90.0, 180.0).model_copy(update={"capture_time_ns": 7_000_000_042})
        peer.say(
            StreamWarning(seq=2, code="quiet", detail="turn it up"),
            captured,
            result(3, 30.0, active=False).model_copy(update={"capture_time_ns": 8 * 10**9}),
        )
        peer.hear()

    service = service_of(script)
    monkeypatch.setattr(
        Node,
        "parameters",
        {
            "url": service.url,
            "array": "square",
            "topic": "/audio",
            "topic_channels": 2,
            "channel_map": "1,0",
            "frame_id": "head",
        },
    )
    node = load("ros2_node").SoundDirections()
    samples = array.array("h", range(320))
    node.subscribed["/audio"](Message(data=samples))
    poses, text = node.publishers_["~/directions"], node.publishers_["~/results"]
    while len(text.messages) < 2:
        assert text.published.wait(TIMEOUT_S)
        text.published.clear()
    node.destroy_node()
    assert heard[0][HEADER.size :] == samples.tobytes()
    assert service.peers[0].start["channel_map"] == [1, 0]
    first, second = poses.messages
    assert first.header.frame_id == "head"
    assert (first.header.stamp.sec, first.header.stamp.nanosec) == (7, 42)
    assert [pose_yaw_deg(pose) for pose in first.poses] == pytest.approx([90.0, 180.0])
    assert second.poses == []  # pausing sources are only in the JSON
    assert json.loads(text.messages[1].data)["sources"][0]["azimuth_deg"] == 30.0
    assert node.logged == ["quiet: turn it up", "destroyed"]


def pose_yaw_deg(pose: Any) -> float:
    """Yaw in degrees of a quaternion about z."""
    return math.degrees(2 * math.atan2(pose.orientation.z, pose.orientation.w))


def test_the_ros_node_records_a_device(
    ros: None, service_of: Callable[..., ScriptedService], monkeypatch: pytest.MonkeyPatch
) -> None:
    heard: list[bytes] = []
    example = load("ros2_node")

    class Device:
        def __init__(self, name: str) -> None:
            assert name == "ReSpeaker"
            self.audio = {"encoding": "pcm_s16le", "sample_rate": 16_000, "channels": 2}

        def feed(self, send: Callable[..., None], stopping: threading.Event) -> None:
            send(bytes(640), 5)
            assert stopping.wait(TIMEOUT_S)

    def script(peer: Peer) -> None:
        peer.begin()
        heard.append(peer.hear())
        done.set()
        peer.hear()

    done = threading.Event()
    monkeypatch.setattr(example, "Microphone", Device)
    parameters = {"url": service_of(script).url, "array": "square", "device": "ReSpeaker"}
    monkeypatch.setattr(Node, "parameters", parameters)
    node = example.SoundDirections()
    assert done.wait(TIMEOUT_S)
    node.destroy_node()
    assert heard == [bytes(640)]
