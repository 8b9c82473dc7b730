"""Multipart bodies: right ones, and such as no library would write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from random import Random
from typing import NamedTuple

BOUNDARY = b"-----7f3a"


class Body(NamedTuple):
    """What a request carries."""

    content_type: str
    content: bytes


Parts = list[tuple[bytes, bytes]]
"""Headers and content of every part"""
Spoil = Callable[[Parts, Random], Body]


def parts_of(audio: bytes, options: Mapping[str, str]) -> Parts:
    """A right form's parts."""
    fields = [
        (
            b'Content-Disposition: form-data; name="%s"' % name.encode(),
            value.encode("utf-8", "replace"),
        )
        for name, value in options.items()
    ]
    disposition = b'Content-Disposition: form-data; name="audio"; filename="a.wav"'
    return [*fields, (disposition + b"\r\nContent-Type: audio/wav", audio)]


def body(parts: Parts, boundary: bytes = BOUNDARY) -> Body:
    """A right body of these parts."""
    content = b"".join(b"--%s\r\n%s\r\n\r\n%s\r\n" % (boundary, head, data) for head, data in parts)
    content_type = f"multipart/form-data; boundary={boundary.decode('latin-1')}"
    return Body(content_type, content + b"--%s--\r\n" % boundary)


def wrong_boundary(parts: Parts, random: Random) -> Body:
    content = body(parts).content
    boundary = random.choice(
        ("", "x", "-" * 70, "a" * 5000, '""', '"' + BOUNDARY.decode() + '"', "a;b", "%00", "é", "=")
    )
    return Body(f"multipart/form-data; boundary={boundary}", content)


def wrong_type(parts: Parts, random: Random) -> Body:
    name = BOUNDARY.decode()
    content_type = random.choice(
        (
            "multipart/form-data",
            "multipart/form-data;",
            f"multipart/form-data; boundary={name}; boundary=other",
            f"multipart/form-data; Boundary={name}",
            f"MULTIPART/FORM-DATA; BOUNDARY={name}",
            f"multipart/mixed; boundary={name}",
            f"multipart/form-data, boundary={name}",
            f"multipart/form-data; boundary*=utf-8''{name}",
            "multipart/form-data; boundary*0=---; boundary*1=--7f3a",
            f"multipart/form-data; boundary={name}; charset={random.choice(CHARSETS)}",
            f"multipart/form-data; charset={random.choice(CHARSETS)}; boundary={name}",
            "multipart/form-data; " + "; ".join(f"p{i}=v" for i in range(300)),
        )
    )
    return Body(content_type, body(parts).content)


CHARSETS = (
    *("utf-8", "latin-1", "utf-16", "utf-32", "utf-7", "ascii", "cp037", "punycode", "idna"),
    *("undefined", "unicode_escape", "raw_unicode_escape", "hex", "zlib", "rot13", "base64", ""),
    *("no-such", "utf-8\\0", "a" * 3000, '"utf-8"', "mbcs", "utf_8_sig", "iso2022_jp", "../x"),
)


def charset(parts: Parts, random: Random) -> Body:
    """A charset that decodes into something else, or not at all."""
    text = random.choice(
        (b"\xff\xfe\xfd", b"\\ud800", b"xn--\x80", b"+2AA-", b"caf\xc3\xa9", b"\\N{x}")
    )
    extra = (b'Content-Disposition: form-data; name="%s"' % random.choice((text, b"method")), text)
    named = [*parts[:-1], extra, parts[-1]]
    content = body(named).content
    name = random.choice(CHARSETS)
    return Body(f"multipart/form-data; boundary={BOUNDARY.decode()}; charset={name}", content)


def cut(parts: Parts, random: Random) -> Body:
    content = body(parts).content
    place = random.choice((random.randrange(len(content)), len(content) - random.randrange(1, 60)))
    return Body(body(parts).content_type, content[: max(place, 0)])


def part_headers(parts: Parts, random: Random) -> Body:
    """Headers of the recording's part that are wrong, missing, or many."""
    audio = parts[-1][1]
    disposition = b'Content-Disposition: form-data; name="audio"; filename="a.wav"'
    head = random.choice(
        (
            b"",
            b"Content-Type: audio/wav",
            b"Content-Disposition: form-data",
            b"Content-Disposition: attachment; name=audio; filename=a.wav",
            b'Content-Disposition: form-data; name="audio"',
            b'Content-Disposition: form-data; name=""; filename=""',
            b'Content-Disposition: form-data; name="audio"; filename="' + b"a" * 70_000 + b'"',
            b"X: " + b"y" * random.choice((5000, 200_000)) + b"\r\n" + disposition,
            b"\r\n".join(b"X-%d: y" % i for i in range(2000)) + b"\r\n" + disposition,
            disposition + b"\r\n" + disposition,
            disposition + b"\r\nno colon here",
            disposition + b"\r\n continued: line",
            disposition.replace(b": ", b":"),
            disposition.replace(b"; ", b";\t"),
            disposition.lower(),
            disposition + b"\r\nContent-Transfer-Encoding: base64",
            disposition + b"\r\nContent-Transfer-Encoding: quoted-printable",
            disposition + b"\r\nContent-Length: 99999999999",
            disposition + b"\r\nContent-Type: " + b"\xff\x00",
            b"\x00\x01: z\r\n" + disposition,
            b"Content-Disposition: form-data; name=\"audio\"; filename*=no-such''%ff",
            b"Content-Disposition: form-data; name*=utf-8''audio; filename*=utf-8''%00",
            b'Content-Disposition: form-data; name="aud\\"io"; filename="a\\',
        )
    )
    return body([*parts[:-1], (head, audio)])


FILENAMES = (
    *(b"", b"../../../etc/passwd", b"a\x00b", b"C:\\temp\\a.wav", b".", b"CON", b"a" * 4000),
    *(b"\xff\xfe", b"%2e%2e%2f", b"a.raw", b"a.npz", b"\xf0\x9f\x8e\xa4.wav", b"a\r\nX: y", b"~/x"),
)


def filename(parts: Parts, random: Random) -> Body:
    head = b'Content-Disposition: form-data; name="audio"; filename="%s"' % random.choice(FILENAMES)
    return body([*parts[:-1], (head, parts[-1][1])])


def many(parts: Parts, random: Random) -> Body:
    """More fields, files or audio than anybody sends."""
    count = random.choice((2, 5, 31, 33, 1000, 5000))
    field = b'Content-Disposition: form-data; name="%s"'
    extra = random.choice(
        (
            [(field % (b"f%d" % i), b"1") for i in range(count)],
            [(field % b"array", b"x")] * count,
            [parts[-1]] * min(count, 8),
            [(field % (b"f%d" % i) + b'; filename="x"', b"1") for i in range(count)],
            [(field % (b"n" * 66_000), b"1")],
            [(field % b"model", b"m" * random.choice((65_000, 66_000, 500_000)))],
        )
    )
    return body(extra + parts if random.random() < 0.5 else parts + extra)


def nested(parts: Parts, random: Random) -> Body:
    """A form inside of a form."""
    inner = body(parts, random.choice((b"inner", BOUNDARY)))
    disposition = b'Content-Disposition: form-data; name="audio"'
    head = disposition + b"\r\nContent-Type: multipart/mixed; boundary=inner"
    return body([*parts[:-1], (head, inner.content)])


def line_ends(parts: Parts, random: Random) -> Body:
    right = body(parts)
    end = random.choice((b"\n", b"\r", b"\r\r\n", b"\n\r"))
    return Body(
        right.content_type, right.content[:2000].replace(b"\r\n", end) + right.content[2000:]
    )


def noise(parts: Parts, random: Random) -> Body:
    """Bytes before, after and within."""
    right = body(parts)
    content = bytearray(right.content)
    for _ in range(random.choice((1, 3, 20))):
        place = random.randrange(min(len(content), 1500))
        content[place] = random.choice((0, 10, 13, 34, 45, 58, 59, 92, 255, random.randrange(256)))
    edges = random.choice((b"", b"preamble\r\n", b"\r\n" * 500, b"-" * 3000))
    return Body(right.content_type, edges + bytes(content) + edges)


SPOILS: tuple[Spoil, ...] = (
    *(wrong_boundary, wrong_type, charset, charset, cut, part_headers, part_headers, filename),
    *(many, nested, line_ends, noise),
)


def spoiled(parts: Parts, random: Random) -> tuple[Body, str]:
    """A form with something wrong, and what it is called."""
    spoil = random.choice(SPOILS)
    return spoil(parts, random), spoil.__name__
