"""Scores of tracks over time against talkers who move, pause and cross.

Task: a tracker reports tracks with ids at every update of a stream whose talkers are known.

Conventions
-----------
Azimuths are in radians. A track of a pausing talker is allowed and not required: it counts neither
as a hit nor as false. Only active tracks are scored. A track belongs to a talker within
``TOLERANCE`` of it, and stays with that talker while this holds (CLEAR MOT).

Scores
------
identity_switches : how often a talker's track has another id than that talker's last track.
missed_share : share of voiced talkers without a track within 10 degrees.
false_tracks_per_minute : ids that belong to no talker in most of their updates.
count_right : share of updates with as many tracks as voiced talkers.
ospa_deg : mean OSPA distance in degrees, cut-off 30.
matched_error_deg : mean error of tracks that belong to a voiced talker.
hota : mean over the streams of detection and association in one number (``hota.py``).
same_id : share of talkers who go on after ``SILENCE_S`` or longer under the id they had.

References
----------
Bernardin, Stiefelhagen, 2008, Evaluating multiple object tracking performance: the CLEAR MOT
metrics.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from model_export.evaluation.tracking.hota import Moment, hota
from service.doa.scoring import circular_error, detection, match, ospa
from service.doa.tracking import Track
from service.doa.types import BoolArray, FloatArray

TOLERANCE = np.deg2rad(20.0)
MISSED = np.deg2rad(10.0)
SILENCE_S = 2.5
"""Least seconds of silence after which a talker returns"""


@dataclass(frozen=True, slots=True)
class Update:
    """One moment of a stream."""

    time: float
    """Seconds"""
    azimuth: FloatArray
    """(M,) radians, directions of the talkers"""
    voiced: BoolArray
    """(M,) whether each of them talks"""
    tracks: Sequence[Track]


@dataclass(slots=True)
class Tally:
    """Sums over the updates of one or many streams."""

    minutes: float = 0.0
    switches: int = 0
    false_tracks: int = 0
    updates: int = 0
    count_right: int = 0
    voiced: int = 0
    missed: int = 0
    ospa: float = 0.0
    returns: int = 0
    same_ids: int = 0
    hotas: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    """Seconds from a talker's first word to its first track"""

    def scores(self) -> dict[str, float]:
        """The scores above, without those that nothing was counted for."""
        found = {
            "identity_switches": float(self.switches),
            "false_tracks_per_minute": self.false_tracks / self.minutes if self.minutes else 0.0,
        }
        if self.updates:
            found["count_right"] = self.count_right / self.updates
            found["ospa_deg"] = float(np.rad2deg(self.ospa / self.updates))
        if self.voiced:
            found["missed_share"] = self.missed / self.voiced
        if self.hotas:
            found["hota"] = float(np.mean(self.hotas))
        if self.returns:
            found["same_id"] = self.same_ids / self.returns
        if self.errors:
            found["matched_error_deg"] = float(np.rad2deg(np.mean(self.errors)))
        if self.latencies:
            found["median_latency_s"] = float(np.median(self.latencies))
        return found


def score(stream: Iterable[Update], tally: Tally, *, least_voiced: int = 1) -> None:
    """Add one stream's scores to a tally.

    Parameters
    ----------
    stream : iterable of Update
        Updates in order of time, evenly spaced.
    tally : Tally
    least_voiced : int
        Updates with fewer voiced talkers count for switches and false tracks only.
    """
    updates = list(stream)
    owners: dict[int, int] = {}
    last_ids: dict[int, int] = {}
    seen: Counter[int] = Counter()
    owned: Counter[int] = Counter()
    returns, moments = _Returns(), []
    for update in updates:
        active = [track for track in update.tracks if track.active]
        owners = belongings(active, update.azimuth, owners)
        returns.add(update, owners, tally)
        moments.append(_moment(update, active, owners))
        seen.update(track.id for track in active)
        owned.update(owners.keys())
        for track_id, talker in owners.items():
            tally.switches += last_ids.get(talker, track_id) != track_id
            last_ids[talker] = track_id
        if update.voiced.sum() >= least_voiced:
            _add_update(update, active, owners, tally)
    tally.hotas.append(hota(moments))
    tally.false_tracks += sum(2 * owned[track_id] <= count for track_id, count in seen.items())
    if len(updates) > 1:
        tally.minutes += (updates[-1].time - updates[0].time) / 60


@dataclass(slots=True)
class _Returns:
    """Talkers of one stream who go on after a silence, and the ids that they had."""

    heard: dict[int, float] = field(default_factory=dict)
    """Seconds at which a talker last talked"""
    ids: dict[int, int] = field(default_factory=dict)
    """Id that a talker last had while talking"""
    waiting: dict[int, int] = field(default_factory=dict)
    """Id that a talker who goes on should have, until a track is there"""

    def add(self, update: Update, owners: Mapping[int, int], tally: Tally) -> None:
        """Count the talkers who begin again, and those whose first track has the old id."""
        talking = np.flatnonzero(update.voiced).tolist()
        for talker in talking:
            silent = update.time - self.heard.get(talker, update.time)
            if silent > SILENCE_S and talker in self.ids:
                self.waiting[talker] = self.ids[talker]
                tally.returns += 1
            self.heard[talker] = update.time
        for track_id, talker in owners.items():
            if talker in talking:
                tally.same_ids += self.waiting.pop(talker, None) == track_id
                self.ids[talker] = track_id


def _moment(update: Update, active: Sequence[Track], owners: Mapping[int, int]) -> Moment:
    """The update without those who rest, and without their tracks."""
    talking = np.flatnonzero(update.voiced)
    resting = set(range(len(update.azimuth))) - set(talking.tolist())
    tracks = [track for track in active if owners.get(track.id) not in resting]
    return Moment(
        talkers=talking.tolist(),
        azimuth=update.azimuth[talking],
        tracks=[track.id for track in tracks],
        reported=np.array([track.azimuth for track in tracks]),
    )


def belongings(
    tracks: Sequence[Track], azimuth: FloatArray, before: Mapping[int, int]
) -> dict[int, int]:
    """Talker by track id, for every track that belongs to one, given the last assignment."""
    kept = {
        track.id: before[track.id]
        for track in tracks
        if track.id in before
        and circular_error(np.array(track.azimuth), azimuth[before[track.id]]) <= TOLERANCE
    }
    free_tracks = [track for track in tracks if track.id not in kept]
    free = [talker for talker in range(len(azimuth)) if talker not in kept.values()]
    pairs = match(np.array([track.azimuth for track in free_tracks]), azimuth[free])
    new = {free_tracks[i].id: free[j] for i, j, error in pairs if error <= TOLERANCE}
    return kept | new


def _add_update(
    update: Update, active: Sequence[Track], owners: Mapping[int, int], tally: Tally
) -> None:
    found = np.array([track.azimuth for track in active])
    voiced = update.azimuth[update.voiced]
    tally.updates += 1
    tally.voiced += len(voiced)
    tally.missed += detection(found, voiced, float(MISSED)).misses
    # A pausing talker's track is no mistake.
    resting = sum(track.id in owners and not update.voiced[owners[track.id]] for track in active)
    tally.count_right += len(active) - resting == len(voiced)
    tally.ospa += ospa(
        np.array([t.azimuth for t in active if t.id not in owners or update.voiced[owners[t.id]]]),
        voiced,
    )
    tally.errors += [
        float(circular_error(np.array(t.azimuth), update.azimuth[owners[t.id]]))
        for t in active
        if t.id in owners and update.voiced[owners[t.id]]
    ]
