"""The list of measurements whose bits a change of the code's shape may not change."""

import json
import subprocess
import sys

import bits

SHARE = 40


def test_another_process_gives_the_same_bits(tmp_path):
    """Exact, whatever was measured before; and the script tells what has changed."""
    here = bits.bits(SHARE)
    assert len(here) > 5
    changed = next(iter(here))
    before, after = tmp_path / "before.json", tmp_path / "after.json"
    before.write_text(json.dumps(here | {changed: "other bits"}))
    process = subprocess.run(
        [
            *(sys.executable, bits.__file__, after),
            *("--against", before, "--share", str(SHARE)),
        ],
        capture_output=True,
        text=True,
    )
    assert process.returncode == 1, process.stderr
    assert process.stdout.splitlines()[1:] == [f"changed: {changed}"]
    assert json.loads(after.read_text()) == here


def test_the_list_is_long_enough():
    assert len({name for name, _, _ in bits.measurements()}) >= 200
