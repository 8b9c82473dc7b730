"""One stream of several sessions: time, numbers and ids go on."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable

import pytest
from scripted_service import TIMEOUT_S, Peer, ScriptedService, options, ready, result, summary

from neuralmusic import NewSession, StreamClient
from neuralmusic.cli.stream_outputs import CsvRows, JsonLines, note
from neuralmusic.protocol.server_messages import (
    OdasSource,
    OdasSst,
    Ready,
    Result,
    StreamSource,
    TrackSummary,
)
from neuralmusic.streams.continuity import Continuity
from neuralmusic.streams.inbox import StreamEvent

ServiceOf = Callable[..., ScriptedService]
NOW = 1000.0


def heard(seq: int, **azimuths_deg: float) -> Result:
    """A result with sources ``i1``, ``i2`` ... at azimuths in degrees."""
    blank = result(seq, 0.0).sources[0]
    sources = []
    for name, azimuth in azimuths_deg.items():
        turned = math.radians(azimuth)
        places = {"azimuth_deg": azimuth, "unit_vector": [math.cos(turned), math.sin(turned), 0.0]}
        sources.append(blank.model_copy(update={"id": int(name[1:]), **places}))
    return result(seq).model_copy(update={"sources": sources})


def ids(continuity: Continuity, now: float, **azimuths_deg: float) -> list[int]:
    told = continuity.follow(heard(1, **azimuths_deg), now)
    assert isinstance(told, Result)
    return [source.id for source in told.sources]


def test_a_stream_goes_on_through_a_restart(service_of: ServiceOf) -> None:
    def lost(peer: Peer) -> None:
        peer.begin("first")
        peer.say(*(heard(seq, i1=40.0, i2=200.0) for seq in (1, 2, 3)))
        peer.close(1012)

    def again(peer: Peer) -> None:
        peer.begin("second")
        peer.say(heard(1, i1=205.0), heard(2, i1=206.0, i2=120.0))
        peer.audio_until("stop")
        peer.finish()

    events: list[StreamEvent] = []
    with StreamClient(service_of(lost, again).url, **options()) as stream:
        while sum(isinstance(event, Result) for event in events) < 5:
            event = stream.receive(TIMEOUT_S)
            assert event is not None
            events.append(event)
        latest = stream.latest
        stream.stop(TIMEOUT_S)
        events += stream.received()
    results = [event for event in events if isinstance(event, Result)]
    assert [r.session for r in results] == ["first"] * 3 + ["second"] * 2
    assert latest == results[-1]
    numbers = [event.seq for event in events if hasattr(event, "seq")]
    assert numbers == sorted(set(numbers))
    times = [r.t_end for r in results]
    assert times == sorted(set(times))
    talkers = [[source.id for source in r.sources] for r in results]
    assert talkers == [[1, 2]] * 3 + [[2], [2, 3]]
    begun = next(event for event in events if isinstance(event, NewSession))
    assert isinstance(events[events.index(begun) - 1], Ready)
    assert (begun.previous, begun.session) == ("first", "second")
    assert begun.t_start >= times[2]
    _check_lines(events, results)


def _check_lines(events: list[StreamEvent], results: list[Result]) -> None:
    """Every line of JSON and CSV names its session, and JSON tells of the new one."""
    lines, rows = io.StringIO(), io.StringIO()
    for output in (JsonLines(lines), CsvRows(rows)):
        for event in events:
            output.show(event)
    told = [json.loads(line) for line in lines.getvalue().splitlines()]
    sessions = [line["session"] for line in told if line["type"] != "warning"]
    assert sessions == ["first"] * 3 + ["second"] * 3
    assert told[3]["type"] == "new_session"
    read = list(csv.DictReader(io.StringIO(rows.getvalue())))
    assert {row["session"] for row in read} == {"first", "second"}
    assert len(read) == sum(len(r.sources) for r in results)
    assert any("second follows first" in (note(event) or "") for event in events)


@pytest.mark.parametrize(
    ("after_s", "azimuth", "id"), [(59.0, 54.0, 1), (61.0, 40.0, 2), (5.0, 56.0, 2), (5.0, -5.0, 2)]
)
def test_an_id_is_kept_at_its_place_for_a_minute(after_s: float, azimuth: float, id: int) -> None:
    continuity = Continuity(live=True)
    continuity.begin(ready("a"), NOW)
    assert ids(continuity, NOW, i1=40.0) == [1]
    continuity.begin(ready("b"), NOW + 1)
    assert ids(continuity, NOW + after_s, i1=azimuth) == [id]


def test_the_nearest_source_gets_the_id_and_none_is_given_twice() -> None:
    continuity = Continuity(live=True)
    continuity.begin(ready("a"), NOW)
    assert ids(continuity, NOW, i4=50.0, i2=40.0) == [4, 2]
    continuity.begin(ready("b"), NOW + 1)
    assert ids(continuity, NOW + 2, i1=47.0, i2=53.0, i3=49.0) == [2, 5, 4]
    continuity.begin(ready("c"), NOW + 3)
    assert ids(continuity, NOW + 4, i1=300.0, i2=53.5) == [6, 5]


@pytest.mark.parametrize(("live", "t_end"), [(True, 0.6 + 7.0 + 0.6), (False, 0.6 + 0.6)])
def test_time_goes_on_by_the_outage_where_audio_is_live(live: bool, t_end: float) -> None:
    continuity = Continuity(live)
    continuity.begin(ready("a"), NOW)
    continuity.follow(heard(1, i1=40.0), NOW + 2)
    _, begun = continuity.begin(ready("b"), NOW + 9)
    told = continuity.follow(heard(1, i1=40.0), NOW + 9.5)
    assert isinstance(told, Result)
    assert told.t_end == pytest.approx(t_end)
    assert begun is not None
    assert (begun.outage_s, begun.t_start) == (7.0, pytest.approx(t_end - 0.6))
    track = TrackSummary(id=1, azimuth_deg=40.0, first_s=0.1, last_s=0.6, active_s=0.5)
    summed = continuity.follow(summary().model_copy(update={"sources": [track]}), NOW + 10)
    assert summed.sources[0].last_s == told.t_end  # type: ignore[union-attr]


def test_odas_tracks_go_on_as_well() -> None:
    continuity = Continuity(live=True)
    empty = OdasSource(id=0, tag="", x=0.0, y=0.0, z=0.0, activity=0.0)

    def tracks(*sources: OdasSource) -> OdasSst:
        return OdasSst(seq=1, timeStamp=100, src=[*sources, empty])

    one = OdasSource(id=7, tag="dynamic", x=1.0, y=0.0, z=0.0, activity=0.9)
    two = one.model_copy(update={"id": 1})
    other = one.model_copy(update={"id": 2, "x": 0.0, "y": 1.0})
    continuity.begin(ready("a"), NOW)
    continuity.follow(tracks(one), NOW)
    continuity.begin(ready("b"), NOW + 4)
    told = continuity.follow(tracks(two, other), NOW + 5)
    assert isinstance(told, OdasSst)
    assert [source.id for source in told.src] == [7, 8, 0]
    assert (told.timeStamp, told.session) == (100 + 500 + 100, "b")


def test_a_single_session_is_told_as_the_service_tells_it() -> None:
    continuity = Continuity(live=True)
    first = ready("a")
    assert continuity.begin(first, NOW) == (first, None)
    said = heard(5, i9=10.0, i3=11.0).model_copy(update={"session": "a"})
    assert continuity.follow(said, NOW) == said
    assert isinstance(said.sources[0], StreamSource)
