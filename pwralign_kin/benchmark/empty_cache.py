"""A cache of prepared models that is empty at first, to measure what the first use costs."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def empty_cache(folder: Path) -> Iterator[None]:
    """Let the block keep prepared models in `folder`, which is empty, and in the usual cache again after it."""
    before = os.environ.get("PWRALIGN_CACHE_DIR")
    os.environ["PWRALIGN_CACHE_DIR"] = str(folder)
    try:
        yield
    finally:
        del os.environ["PWRALIGN_CACHE_DIR"]
        if before is not None:
            os.environ["PWRALIGN_CACHE_DIR"] = before
