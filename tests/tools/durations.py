"""CPU seconds of tests, by which `conftest.py` marks the slow ones.

``python tests/tools/durations.py`` runs all tests with an empty cache of kernels,
writes the durations anew, and repeats the quick ones alone until all of them are: what
shares a kernel or a fixture with a slow test has to pay for it there. The machine must
do nothing else. ``--quick`` does the second part only, and adds what has become slow.

`tests/durations.txt` holds what takes more than `LIMIT`, by test function: the CPU
time of its longest case, threads and processes that it started included; and
``alone`` if it takes that long only where no slow test is run before it.
"""

import argparse
import os
import tempfile
from pathlib import Path
from statistics import median

STORED = Path(__file__).parents[1] / "durations.txt"

# CPU seconds of a test, set-up included, from which on it is slow: such that all quick
# ones together take two minutes of CPU time, whatever is imported and collected
# included. Tests of a promise (the mark `promise`), one for each, may take longer.
LIMIT = 0.15
LIMIT_OF_PROMISE = 1.5

# From which on one that has no entry is told.
UNKNOWN = 0.5

# By how much a duration may differ from what is stored.
FACTOR = 2


def read():
    """Stored CPU seconds, by the names of test functions."""
    rows = (line.split() for line in STORED.read_text().splitlines())
    return {name: float(seconds) for seconds, name, *_ in rows}


def alone():
    """Names of what is slow only where no slow test is run before it."""
    rows = (line.split() for line in STORED.read_text().splitlines())
    return {name for _, name, *more in rows if more}


def write(seconds, quicker=()):
    """Store what is slow, of which some are `quicker` after others."""
    slow = sorted(name for name, one in seconds.items() if one >= LIMIT)
    rows = [f"{seconds[x]:.2f} {x}{' alone' * (x in quicker)}\n" for x in slow]
    STORED.write_text("".join(rows))


def function_of(nodeid):
    """Name of a test function, from the name of one of its cases."""
    return nodeid.partition("[")[0].removeprefix("tests/")


def is_slow(seconds, promised):
    """Whether a test of such a duration is slow, which may be that of a promise."""
    return seconds >= (LIMIT_OF_PROMISE if promised else LIMIT)


def cpu_seconds():
    """CPU seconds of this process and of those that it has waited for."""
    return sum(os.times()[:4])


class Taken:
    """Durations of a session's tests: the longest case of each function, and the sum.

    Another machine is faster or slower: by the median of all that is stored.
    """

    def __init__(self):
        self.longest, self.total = {}, 0.0

    def add(self, nodeid, seconds):
        """Add a case."""
        name = function_of(nodeid)
        self.longest[name] = max(seconds, self.longest.get(name, 0.0))
        self.total += seconds

    def wrong(self, stored, quicker=()):
        """Lines about what is not stored, or is wrong by more than `FACTOR`.

        Those that are `quicker` after others may take less.
        """
        both = self.longest.keys() & stored.keys()
        known = [self.longest[name] / stored[name] for name in both]
        speed = median(known) if len(known) >= 20 else 1.0
        lines = []
        for name, seconds in sorted(self.longest.items()):
            seconds, before = seconds / speed, stored.get(name, 0.0)
            more = seconds > FACTOR * before and seconds >= UNKNOWN
            less = seconds < before / FACTOR and name not in quicker
            if more or less:
                lines.append(f"{name}: {seconds:.2f} s, stored {before:.2f} s")
        return lines


TAKEN = Taken()


def measured(marks):
    """Run the tests of such marks from an empty cache; CPU seconds by function."""
    import durations  # the module that conftest.py fills
    import pytest

    durations.TAKEN.__init__()
    with tempfile.TemporaryDirectory() as home:
        os.environ["HOME"] = home  # where Dr.Jit has its cache
        pytest.main(["-n", "2", "-m", marks, "-q", "-p", "no:cacheprovider"])
    return durations.TAKEN.longest


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--quick", action="store_true", help="the quick tests only")
    options = parser.parse_args()
    if not options.quick:
        write(measured(""))
    limit = LIMIT
    while True:
        before, found = read(), measured("not slow")
        more = {k: s for k, s in found.items() if s >= max(limit, before.get(k, 0))}
        new = more.keys() - before.keys()
        write(before | more, alone() | new)
        if not new:
            break
        limit = UNKNOWN  # else whatever compiles a common kernel, one by one


if __name__ == "__main__":
    main()
