"""Every threshold that decides a diagnosis: its meaning, and where its value comes from.

A diagnosis reads its thresholds from one `Policy`, which its `Base` carries, so a test can change one of them
and watch the decision change: `tests/diagnosis/test_policy.py` does so for each. What is only numerical, such
as a rank tolerance, stays beside the code that uses it.
"""

from dataclasses import dataclass

from hallsym.estimation.goodness_of_fit import WORTH_REPORTING


@dataclass(frozen=True)
class Policy:
    """The thresholds, by the stage that reads them. Each says what it decides, then why it has this value."""

    # levels and shares that several decisions have in common

    false_alarm: float = 0.05
    """Probability of a statement about a log in which nothing is, all that was tried counted; half of it
    on each side of an interval, and for an excess without a shape. The usual 5 %."""
    certain: float = 0.01
    """Corrected p-value below which an effect, a fault or a smaller finding is certain. The usual 1 %."""
    negligible: float = 0.03
    """Share below which nothing is a finding: of what a best effect explains and a plainer one leaves,
    and of the gap; of an excess, of the largest wave, of a noise floor. Below the 5 % that are worth
    reporting. A noise floor from 560 samples at rest is known to 3 %."""
    minor: float = 0.1
    """Share up to which a part is minor: of the excess that named effects leave open in a gap that is
    explained; of the threshold that a smaller finding is worth; by which a steady line scatters less than the
    rest of a spectrum; of the error rate, for a test beside that by signs (by the noise)."""
    half: float = 0.5
    """Part above which something is the larger one: of the threshold, for a first, certain effect to be
    taken up, and that a refit must keep of its score; of what a parameter alone makes, that the others
    must leave; of far samples that have others around them; of the best effect's gain, for an effect to
    be refitted exactly; of a curve that one sensor makes if named; of an error, for the
    reference to be blamed for it; of the variance of the noise, for an error beyond it to stay open in a gap
    that is explained (1.22 x the floor). A majority. An effect may be worth
    twice as much on the holdout runs, which decide."""
    fewest: int = 6
    """Fewest runs, or units of time, whose scatter is used: for an interval of the shrinkage, sign flips,
    a single run among others, pieces of a short recording. With 6 of them Student's interval is 2.6
    standard errors wide, with 4 it is 3.2."""

    # noise: what is independent, and what its tails are like

    fewest_units: int = 24
    """Fewest runs for which runs are the units of sign flips; else stretches are, about as many. So many
    units have 2^23 different signs, far more than are drawn."""
    forgotten: float = 0.02
    """Autocorrelation below which the correlation length of a residual ends. Noise has it by chance after
    some 10,000 readings."""
    memories: float = 4.0
    """Correlation lengths of a residual above which stretches of it are independent. The scores of
    neighbouring stretches of an autoregressive residual then have a correlation of 3 %."""
    heavy: float = 5.0
    """Kurtosis above which chi-square is not used. That of Student's t of 7 degrees of freedom."""
    tails: float = 2.0
    """Factor within which the body of heavy-tailed noise predicts the number of samples in its tails.
    Student's t of 3 degrees of freedom in every reading and reference has up to 1.5 times as many."""
    smooth: float = 0.25
    """Correlation of neighbouring time shifts above which they are no jitter, which has none. White noise
    has -0.08 after the running median, noise correlated over 3 samples 0.3, a finely sampled gap of the
    model nearly 1."""

    # input: which runs judge, and which gap counts

    worth_reporting: float = WORTH_REPORTING
    """Relative decrease of the gap metric above which a gap is worth reporting. A choice; the user
    (`threshold`) or the log (meta.json) may state another."""
    holdout_every: int = 5
    """One run of so many is holdout where neither the user nor the log names holdout runs. A fifth of
    the runs judges, as in 5-fold cross-validation."""

    # selection and verdict

    rail_repeats: int = 4
    """Times that a channel must take its very highest or lowest value for that to be a rail. A turning
    point may fall on one step of the converter two or three times."""
    most_refits: int = 6
    """Effects refitted exactly in one step. Cost: a refit takes about five passes over the log."""
    starts: int = 3
    """Starts refitted of an effect whose numbers were searched on a grid. The score of one grid point,
    such as a rail, is a poor predictor of the result of a refit."""
    as_good: float = 10.0
    """Difference of BIC below which a variant with as few parameters as another effect explains as much;
    above twice that, an effect with needless parameters does not compete with a plainer one. "Very strong"
    evidence of Kass and Raftery (1995)."""

    # confusable effects

    separated: float = 5.0
    """Standard deviations at which something is certain without a test: two effects differ (of a slow
    average), a coordinate varies (of its noise). The convention of 5 sigma."""


POLICY = Policy()
"""The default thresholds of a diagnosis."""
