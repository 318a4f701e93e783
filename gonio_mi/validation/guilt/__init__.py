"""Which function is guilty, and of what.

:mod:`.hypotheses` is what is asked in turn, :mod:`.case` what is known by then. Others
hold hypotheses: on answers about samples, whose :mod:`.ratios` a factor may explain, on
counts of directions, and on cosines.
"""
