"""The mutated uploads: an index gives the same request, always."""

from __future__ import annotations

from dataclasses import dataclass
from random import Random
from urllib.parse import quote_from_bytes

from . import forms
from .damage import damaged
from .options import spoil
from .seeds import seeds

SEED = 20_260_101
CONTENT_TYPES = (
    *("audio/wav", "audio/wav", "application/octet-stream", "audio/flac", "audio/ogg", "audio/x"),
    *("application/ogg", "audio/wav; charset=undefined", "AUDIO/WAV", "text/plain", "audio/", ""),
)


@dataclass(frozen=True, slots=True)
class Upload:
    """One request to ``POST /localize``."""

    index: int
    what: str
    """The format and what was done to it"""
    query: str
    content_type: str
    content: bytes


def upload(index: int) -> Upload:
    """The mutant of this index."""
    random = Random(f"{SEED}:upload:{index}")
    seed = random.choice(seeds())
    # Cheap ones: 20,000 answers are to be had in minutes.
    options = {"array": seed.array, "method": random.choice(("music", "srp_phat", "norm_music"))}
    if random.random() < 0.04:
        options["method"] = "neural"
    aim = random.random()
    if aim < 0.7:
        content, what = damaged(seed.content, random)
        query, body = _sent(content, list(options.items()), random)
    elif aim < 0.85:
        body, what = forms.spoiled(forms.parts_of(seed.content, options), random)
        query = ""
    else:
        what = "options"
        query, body = _sent(seed.content, spoil(options, random), random)
    return Upload(index, f"{seed.kind} {what}", query, body.content_type, body.content)


def _sent(content: bytes, options: list[tuple[str, str]], random: Random) -> tuple[str, forms.Body]:
    """Raw with the options in the query, or as a form."""
    if random.random() < 0.5:
        return _query(options), forms.Body(random.choice(CONTENT_TYPES), content)
    fields = [
        (b'Content-Disposition: form-data; name="%s"' % _bytes(name), _bytes(value))
        for name, value in options
    ]
    return "", forms.body([*fields, forms.parts_of(content, {})[0]])


def _query(options: list[tuple[str, str]]) -> str:
    return "&".join(
        f"{quote_from_bytes(_bytes(name))}={quote_from_bytes(_bytes(value))}"
        for name, value in options
    )


def _bytes(text: str) -> bytes:
    return text.encode("utf-8", "surrogatepass")
