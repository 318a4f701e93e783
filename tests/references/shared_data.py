"""Real files of instruments, where they are present: GONIO_DATA names their folder."""

import os
from pathlib import Path

import pytest

DATA = Path(
    os.environ.get("GONIO_DATA")
    or next(
        (p / "shared/data" for p in Path(__file__).parents if (p / "shared").is_dir()),
        "absent",
    )
)


def real(name):
    path = DATA / name
    if not path.exists():
        pytest.skip(f"GONIO_DATA has no file {name}")
    return path
