"""Single precision, in which the instrument computes, and what it leaves of a number.

Both are relative errors. What is larger, because more than a few operations lead to it,
has a name of its own where it was measured.
"""

# Of one operation: half a unit in the last place.
ROUNDING = 2.0**-24

# Of a few operations, 16 of one: edges of patches and weights of events are not
# known any better.
FEW_ROUNDINGS = 2.0**-20

# Of what a function of a BSDF answers, and between two ways to compute it: 1024
# operations. Of Mitsuba's own those of `hair` have most, 962; those of `principled` up
# to 376.
BSDF_ROUNDING = 1024 * ROUNDING
