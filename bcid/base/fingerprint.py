"""Fingerprints: short hashes that say whether two computations had the same input."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np


def fingerprint(content: Any) -> str:
    """Hash (16 hex digits) of nested dicts, lists, numbers, text, paths and arrays; the order of dict keys does not matter."""
    digest = hashlib.sha256()
    _feed(digest, content)
    return digest.hexdigest()[:16]


def file_fingerprint(path: str | Path) -> str:
    """Hash of a file's bytes."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()[:16]


def _feed(digest: Any, content: Any) -> None:
    if isinstance(content, dict):
        for key in sorted(content, key=str):
            digest.update(f"{{{key}:".encode())
            _feed(digest, content[key])
    elif isinstance(content, list | tuple):
        digest.update(f"[{len(content)}".encode())
        for item in content:
            _feed(digest, item)
    elif isinstance(content, np.ndarray) and content.dtype.kind in "OUS":
        _feed(digest, [str(item) for item in content.ravel()])
    elif isinstance(content, np.ndarray):
        digest.update(f"{content.dtype.kind}{content.shape}".encode())
        digest.update(np.ascontiguousarray(content).tobytes())
    elif isinstance(content, np.generic):
        _feed(digest, content.item())
    else:
        digest.update(f"{type(content).__name__}={json.dumps(content, default=str)};".encode())
