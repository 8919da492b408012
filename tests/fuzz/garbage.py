"""Seeded garbage: values, texts, bytes and messages of the kinds that break programs; the same seed, the same."""

from __future__ import annotations

import random
import struct
from typing import Any

_FLOATS = (0.0, -0.0, 1.0, -1.0, 0.01, 1e-320, 1e308, -1e308, 2.0**63, float("inf"), float("-inf"), float("nan"))
_WHOLE = (0, 1, -1, 2, 7, 255, 2**31, 2**32 - 1, 2**53 + 1, 2**63 - 1, -(2**63), 2**64, 10**400)
_TEXTS = (
    "", " ", "a", "off", "NaN", "../../etc/passwd", "/dev/null", "x" * 300, "ä→𝔘", "a\0b", "a\nb", "\x1b[2J", "$(id)",
    "%s%n", "{0}", "'\";--", "1e999", "length=nan", "length=", "=1", "length=1e400", "s" * 5000, "\u202e", "!!python/x",
)  # fmt: skip
_YAML = (
    "[", "]", "{", "}", ": ", "- ", "&a ", "*a", "<<: *a", "!!binary x", "!!int x", "!!float x", "!!timestamp x", "|\n",
    "!!python/object/apply:os.system [id]", "2001-99-99", "0x" + "f" * 6000, "9" * 5000, "1" + "0" * 400, ".nan",
    ".inf", "~", "yes", "? [a]\n: b", "\t", "'", '"', '"\\0"', "#", "---\n", "%TAG ! x", "0o9", "1:99:99", "[" * 600,
    "!!set {a, b}", "!!omap [a: b]", "=", "\ufeff", '"' + "a" * 300 + '"', "''", "1_0", "-.INF", "{a: 1, a: 2}",
)  # fmt: skip

_RANGES = {
    "boolean": (0, 1), "octet": (0, 255), "uint8": (0, 255), "int8": (-128, 127), "uint16": (0, 2**16 - 1),
    "int16": (-(2**15), 2**15 - 1), "uint32": (0, 2**32 - 1), "int32": (-(2**31), 2**31 - 1), "uint64": (0, 2**64 - 1),
    "int64": (-(2**63), 2**63 - 1),
}  # fmt: skip


class Garbage(random.Random):
    """A source of garbage for one input."""

    def maybe(self, share: float) -> bool:
        """True in this share of the times."""
        return self.random() < share

    def number(self) -> Any:
        """A float or an integer."""
        kind = self.randrange(4)
        if kind == 0:
            return self.choice(_FLOATS)
        if kind == 1:
            return self.choice(_WHOLE)
        return self.gauss(0.0, 10.0 ** self.randint(-3, 6)) if kind == 2 else self.randint(-3, 1000)

    def text(self) -> str:
        """A text; without halves of surrogate pairs, which no encoding carries."""
        if self.maybe(0.7):
            return self.choice(_TEXTS)
        letters = (chr(self.choice((self.randrange(128), self.randrange(0xD800)))) for _ in range(self.randrange(20)))
        return "".join(letters)

    def value(self, depth: int = 3) -> Any:
        """Anything that JSON or YAML can carry."""
        kind = self.randrange(7 if depth else 4)
        if kind < 2:
            return self.number()
        if kind == 2:
            return self.text()
        if kind == 3:
            return self.choice((None, True, False))
        if kind == 4:
            return {self.text(): self.value(depth - 1) for _ in range(self.randrange(4))}
        return [self.value(depth - 1) for _ in range(self.randrange(6))]

    def bent_tree(self, tree: Any) -> Any:
        """A copy of nested mappings and lists in which something has been replaced, removed, added or renamed."""
        if self.maybe(0.15) or not isinstance(tree, (dict, list)) or not tree:
            return self.value()
        bent = tree.copy()
        place = self.choice(list(tree)) if isinstance(tree, dict) else self.randrange(len(tree))
        kind = self.randrange(8)
        if kind == 0:
            del bent[place]
        elif kind == 1 and isinstance(tree, dict):
            bent[self.choice((self.text(), self.number(), None, True, str(place)[:-1]))] = bent.pop(place)
        elif kind == 2 and isinstance(tree, dict):
            bent[self.text()] = self.value()
        else:
            bent[place] = self.bent_tree(tree[place])
        return bent

    def bent_text(self, text: str) -> str:
        """A copy of a YAML text in which lines or signs have been removed, doubled, or replaced by what YAML knows."""
        for _ in range(self.randint(1, 4)):
            at = self.randrange(len(text) + 1)
            end = min(len(text), at + self.choice((0, 1, 1, 5, 40)))
            kind = self.randrange(4)
            new = ("", text[at:end] * 2, self.choice(_YAML), self.text())[kind]
            text = text[:at] + new + text[end:]
        return text

    def bent_bytes(self, data: bytes) -> bytes:
        """A copy with flipped, overwritten, inserted or missing bytes; or any bytes of any length."""
        if self.maybe(0.1):
            return self.randbytes(self.choice((0, 1, 3, 4, 5, 11, 12, 40, 64, 200, 3000)))
        bent = bytearray(data)
        for _ in range(self.randint(1, 4)):
            at = self.randrange(len(bent) + 1)
            kind = self.randrange(5)
            if kind == 0 and at < len(bent):
                bent[at] ^= 1 << self.randrange(8)
            elif kind == 1:
                bent[at : at + 4] = self.choice((bytes(4), b"\xff" * 4, b"\xff\xff\xff\x7f", self.randbytes(4)))
            elif kind == 2:
                bent[at : at + 8] = struct.pack("<d", self.choice(_FLOATS))
            elif kind == 3:
                bent[at:at] = self.randbytes(self.randrange(9))
            else:
                del bent[at:]
        return bytes(bent)

    def message(self, prototype: Any, share: float = 0.3) -> Any:
        """Fill this share of the fields of a ROS message with garbage; returns it."""
        for name, kind in prototype.get_fields_and_field_types().items():
            present = getattr(prototype, name)
            if hasattr(present, "get_fields_and_field_types"):
                self.message(present, share)
            elif self.maybe(share):
                setattr(prototype, name, self._field(kind, present))
        return prototype

    def _field(self, kind: str, present: Any) -> Any:
        if kind.startswith("sequence<"):
            inner = kind[len("sequence<") : -1]
            if inner in _RANGES or inner in ("double", "float", "string"):
                length = self.choice((0, 1, 2, 3, 4, 5, len(present), len(present), 100))
                return [self._field(inner, None) for _ in range(length)]
            return [self.message(part) for part in present]
        if kind in ("double", "float"):
            return self.choice(_FLOATS) if self.maybe(0.5) else self.gauss(0.0, 10.0 ** self.randint(-3, 6))
        if kind == "boolean":
            return self.maybe(0.5)
        if kind == "octet":
            return self.randbytes(1)
        if kind in _RANGES:
            low, high = _RANGES[kind]
            near = 0 if present is None else min(max(int(present) + self.randint(-2, 2), low), high)
            return self.choice((low, high, near, near, self.randint(low, high), min(high, self.randrange(10))))
        return self.text() if kind.startswith("string") else present
