"""What a reproducer says."""

import contextlib
import io
import re

# Units in which two numbers are apart, and how many of them chance does not explain in
# all of these scripts together; of roundings of a thousand operations one would do.
BEYOND = {"standard errors": 7.0, "roundings": 4.0}


# How lines begin that say what the code does, or are no part of it.
WORDS = ("#", "import ", '"""')


def code_of(text):
    """Lines of code, without words."""
    lines = (line for line in text.splitlines() if line.strip())
    return [line for line in lines if not line.strip().startswith(WORDS)]


def told(text):
    """How far apart the two numbers of a script are, in what is beyond doubt."""
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        exec(compile(text, "reproducer.py", "exec"), {"__name__": "__main__"})
    found = re.search(r"which must be equal: (True|False)\s*$", said.getvalue())
    if found:
        return 0.0 if found[1] == "True" else float("inf")
    found = re.search(r": (\S+) (standard errors|roundings)\s*$", said.getvalue())
    size, unit = found.groups()
    return float(size) / BEYOND[unit]


def is_short(text):
    """At most 40 lines of code, and 14 more by which a phase function is asked."""
    return len(code_of(text)) <= (54 if "class Scatterer" in text else 40)
