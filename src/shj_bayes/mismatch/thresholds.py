"""Every number on which a diagnosis turns, with its reason; fixed on development seeds, never on proof seeds.

How they were set, and what they give on development trials, stands in ``docs/decisions/0005-mismatch.md``.
"""

LINE = 1e-3  # chance below which a line over time counts as part of what is left
ALPHA = 0.02  # of a false alarm in a recording with nothing missing; halved for each effect already found
PRACTICAL = 0.01  # of Fy: a smaller effect is negligible for design and is reported with its size, not raised
GAIN_SE = 3.0  # standard errors by which the held-out gain of an effect must exceed 0, or
GAIN_NATS = 8.0  # held-out gain in log density, without the best block, that is beyond chance by itself: in noise, with
# that block, 5.5 at most in 105 devices
RIVAL_SE = 2.0  # standard errors by which the best effect must beat another one to exclude it
AS_GOOD = 0.8  # of the best gain: a simpler effect with less does not come first, however few cycles there are
RIVAL_PROBABILITY = 0.05  # a rival that wins in this share of resampled cycle sets is not excluded
MAX_EFFECTS = 4
EXPLAINED = 0.85  # of the misfit above noise: with less, and an alarm that is left, the catalogue has not explained it
WORTH = 0.1  # of the misfit above noise: an effect that takes up less gets a name only if it takes up
NOTABLE = 0.03  # of Fy, root mean square, or, with a gain of GAIN_SE standard errors,
OF_REST = 0.2  # of what is left (of what the formulas of right effects left, wrong ones took up 0.05 at most), or is
LARGE = 0.1  # of Fy somewhere (a slack, while the force is uneven by far more) and takes up
PART = 0.03  # of the misfit above noise
REPEATED = 0.8  # of what comes again from cycle to cycle: taken up by less, and the catalogue has not explained it
REPEAT_P = 0.01  # chance below which something comes again
RIVAL_MASS = 0.99  # of the resampled cycle sets; rivals that win only in the rest are not listed
ALIAS = 0.9  # cosine above which two effects cannot be told apart by this displacement history
# A formula for what no effect explains is learnt on every other cycle and must, on the cycles between them,
FORMULA_SHARE = (
    0.8  # take up this much of what comes again over its coordinate: shapes that were right gave 0.9 and more
)
FORMULA_PART = 0.25  # take up this much of all that is left, noise included: of less it is a remark, not an explanation
FORMULA_P = 0.01  # be beyond chance, by flipping whole half-cycles
