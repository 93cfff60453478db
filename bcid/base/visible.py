"""Text of others on a terminal and in text files: what would move the cursor, colour or turn text around is shown instead."""

from __future__ import annotations

import re

# Control characters but for new lines and tabs, characters that turn text around or are invisible, and single surrogates,
# which stand for bytes of file names that are not UTF-8.
_UNSEEN = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028\u2029\u202a-\u202e\u2060-\u2069\ufeff\ud800-\udfff]"
)


def visible(text: object) -> str:
    """The text with each such character written as its escape, as ``\\x1b``."""
    return _UNSEEN.sub(lambda found: _escape(ord(found.group())), str(text))


def _escape(code: int) -> str:
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
