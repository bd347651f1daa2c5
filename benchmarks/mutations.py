"""Files gone wrong: bytes, words, values and messages of whole ones changed at random, the same for the same seed."""

import re
from collections.abc import Callable
from copy import deepcopy
from io import BytesIO
from random import Random
from typing import Any

import msgspec

Mutate = Callable[[bytes, Random], bytes]

_NASTY_WORDS = (
    *("nan", "inf", "-inf", "1e308", "-1", "0", "-0.0", "1e-320", "9223372036854775808", "99999999999999999999999"),
    *("9" * 5000, '""', "''", "null", "true", "[]", "{}", "[[]]", "[" * 3000, "{a: " * 500, "<a>", "&x;", "*x"),
    *("\0", "\x1b[31m", "\r\n", "\u202e", "\ufeff", "\ud7ff", "../../x", "/", ".", "$(x)", '"""', "\\", "%s%n"),
    *("!!x", "x" * 10_000),
)  # fmt: skip
_NASTY_VALUES: tuple[Any, ...] = (
    *(None, True, -1, 0, 1, 2**31, 2**53, -(2**63), 2**64 - 1, 1e308, -1e308, 1e-320, 0.5),
    *("", "x", "nan", "\0", "\x1b[31m", "a\nb", "../../x", "x" * 10_000),
    *([], {}, [[]], [0.0] * 9, [1] * 3, [[1.0, 2.0, 3.0]] * 3, {"kind": "points"}),
)
# Parts of text that mean something by themselves.
_WORDS = re.compile(r"[A-Za-z_]+|[-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?|\s+|.", re.DOTALL)


def mutated_bytes(data: bytes, draw: Random) -> bytes:
    """Bits flipped, numbers of eight bytes made absurd, pieces taken out, put in, doubled; or the end cut off."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 30))):
        place = draw.randrange(max(len(changed), 1))
        match draw.randrange(12):
            case 0 | 1:
                changed[place : place + 1] = draw.randbytes(1)
            case 2 | 3:
                changed[place : place + 8] = draw.choice((b"\xff" * 8, bytes(8), b"\xff\xff\xff\x7f\0\0\0\0"))
            case 4 | 5:
                del changed[place : place + draw.randrange(1, 60)]
            case 6 | 7:
                changed[place:place] = draw.randbytes(draw.randrange(1, 20))
            case 8:
                other = draw.randrange(max(len(changed), 1))
                changed[place:place] = changed[other : other + draw.randrange(1, 2000)]
            case 9:
                changed[place : place + 1] = bytes(
                    [(changed[place : place + 1] or b"\0")[0] ^ 1 << draw.randrange(8)]
                )
            case 10:
                changed[place : place + 4] = draw.choice((b"\xff\xff\xff\x7f", b"\0\0\0\x01", b"\x7f\xff\xff\xff"))
            case _:
                if draw.random() < 0.3:
                    del changed[place:]
    return bytes(changed)


def mutated_text(data: bytes, draw: Random) -> bytes:
    """Words exchanged for others, left out, doubled, and lines moved; now and then bytes."""
    if draw.random() < 0.15:
        return mutated_bytes(data, draw)
    words = _WORDS.findall(data.decode("utf-8", "replace"))
    for _ in range(draw.choice((1, 1, 1, 2, 4))):
        place, other = draw.randrange(len(words) or 1), draw.randrange(len(words) or 1)
        match draw.randrange(6):
            case 0 | 1 | 2:
                words[place : place + 1] = [draw.choice(_NASTY_WORDS)]
            case 3:
                words[place : place + 1] = words[other : other + 1]
            case 4:
                del words[place : place + draw.choice((1, 1, 5, 40))]
            case _:
                words[place:place] = words[other : other + draw.choice((1, 20, 200))]
    return "".join(words).encode("utf-8", "surrogatepass")


def mutated_json(data: bytes, draw: Random) -> bytes:
    """Values of a JSON document exchanged for others, left out and repeated; it stays JSON."""
    try:
        root = [msgspec.json.decode(data)]
    except msgspec.DecodeError:
        return mutated_text(data, draw)
    for _ in range(draw.choice((1, 1, 1, 2, 5))):
        places = list(_places(root))
        holder, key = draw.choice(places)
        match draw.randrange(5):
            case 0 | 1 | 2:
                # A list that is put in twice must not be one.
                holder[key] = deepcopy(draw.choice(_NASTY_VALUES))
            case 3 if holder is not root:
                del holder[key]
            case _:
                other, its = draw.choice(places)
                # A copy, or what holds itself could not be written.
                holder[key] = msgspec.json.decode(msgspec.json.encode(other[its]))
    return msgspec.json.encode(root[0])


def _places(value: Any) -> Any:
    """Every list or dict of a document with a key in it, the first few of long lists."""
    keys = list(value) if isinstance(value, dict) else range(min(len(value), 40))
    for key in keys:
        yield value, key
        if isinstance(value[key], (dict, list)):
            yield from _places(value[key])


def forged_mcap(data: bytes, draw: Random) -> bytes:
    """An MCAP file whose messages, names and times are changed, and that is whole as a file: its sums agree."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, Writer

    try:
        header = make_reader(BytesIO(data)).get_header()
        held = list(make_reader(BytesIO(data)).iter_messages(log_time_order=False))
        attachments = list(make_reader(BytesIO(data)).iter_attachments())
    except Exception:
        return mutated_bytes(data, draw)
    stream = BytesIO()
    writer = Writer(stream, compression=draw.choice(list(CompressionType)), chunk_size=draw.choice((2000, 1 << 20)))
    writer.start(header.profile, header.library)
    channels: dict[int, int] = {}
    names = {channel.id: _name(channel.topic, draw) for channel in {c.id: c for _, c, _ in held}.values()}
    chosen = {draw.randrange(len(held)) for _ in range(draw.choice((0, 1, 1, 3)))} if held else set()
    for k, (schema, channel, message) in enumerate(held):
        if channel.id not in channels:
            kind = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
            encoding = draw.choice(("json", "cdr", "protobuf")) if draw.random() < 0.02 else channel.message_encoding
            given = writer.register_schema(*kind)
            channels[channel.id] = writer.register_channel(names[channel.id], encoding, given)
        change = mutated_json if channel.message_encoding == "json" else mutated_bytes
        content = change(message.data, draw) if k in chosen else message.data
        time = draw.choice((0, 2**63, 2**64 - 1)) if draw.random() < 0.005 else message.log_time
        writer.add_message(channels[channel.id], time, content, message.publish_time)
    for one in attachments:
        content = mutated_text(one.data, draw) if draw.random() < 0.3 else one.data
        writer.add_attachment(one.create_time, one.log_time, one.name, one.media_type, content)
    writer.add_metadata("quadrig", {"version": draw.choice(("1", "\x1b[31m"))})
    writer.finish()
    return stream.getvalue()


def _name(name: str, draw: Random) -> str:
    """Now and then a name that nobody expects."""
    if draw.random() < 0.85:
        return name
    return draw.choice(
        ("", "/", "..", "/../../x", "/a\nb", "/\x1b[31mred", "/nul\0", "/" + "x" * 10_000, "/tf", name + "/")
    )


def either(*ways: Mutate) -> Mutate:
    """One of these ways, by chance."""
    return lambda data, draw: draw.choice(ways)(data, draw)
