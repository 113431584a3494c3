"""Every threshold that decides a diagnosis: its meaning, and where its value comes from.

A diagnosis reads its thresholds from one `Policy`, so a test can change one of them and watch the decision
change: `tests/diagnosis/test_policy.py` does so for each. What is only numerical, such as a rank tolerance,
stays beside the code that uses it.
"""

from dataclasses import dataclass

from hallsym.estimation import UNSTRUCTURED


@dataclass(frozen=True)
class Policy:
    """The thresholds, by the stage that reads them. Each says what it decides, then why it has this value."""

    # input: which runs judge, and which gap counts

    worth_reporting: float = 0.05
    """Relative decrease of the gap metric from which on a gap is worth reporting.

    A choice; the user (--threshold) or the log (meta.json) may state another."""
    holdout_every: int = 5
    """One run of so many is held out where neither the user nor the log names holdout runs.

    A fifth of the runs judges, as in 5-fold cross-validation."""
    fewest_runs: int = 3
    """Runs below which a recording is split. Two to fit, so that one checks the other, and one to judge."""

    # screening and selection

    certain: float = 0.01
    """Corrected p-value below which an effect, a fault or a smaller finding is certain.

    The usual 1 %."""
    half: float = 0.5
    """Part of the threshold from which on a first, certain effect is taken up, that an exact refit must keep
    of what its score promised, and that a likely shape or a line must explain.

    An effect may be worth twice as much on the holdout runs, which decide (a temperature that only they
    reach)."""
    rail_repeats: int = 4
    """Times that a channel must take its very highest or lowest value for that to be a rail.

    A turning point may fall on one step of the converter two or three times."""
    inflation: float = 2.0
    """Variance of a slow average over that of white noise, assumed by BIC during the search.

    Unknown before the search ends; it only weighs parameters against squares."""
    promising: float = 0.75
    """Part of the best effect's gain, to first order, from which on an effect is refitted exactly.

    A score is good to about a quarter for an effect that is not linear."""
    most_refits: int = 6
    """Effects refitted exactly in one step. Cost: a refit takes about five passes over the log."""
    starts: int = 3
    """Starts refitted of an effect whose numbers were searched on a grid.

    The score of one grid point, such as a rail, says little of where a refit ends."""
    simpler_gain: float = 0.97
    """Part of the best effect's gain that an effect with fewer parameters must explain to be preferred.

    By BIC: what noise alone gives to the further parameters does not count. Below the 5 % that are worth
    reporting: what it leaves out is no finding."""
    simpler_gap: float = 0.01
    """Relative gap by which an effect with fewer parameters may be worse than the best and be preferred.

    Below the 5 % that are worth reporting: what it leaves out is no finding."""
    as_good: float = 10.0
    """Difference of BIC up to which a variant with as few parameters as another effect explains as much.

    What Kass and Raftery (1995) call very strong."""
    plain_pairs: int = 2
    """Plain effects that, each with a second effect, compete with a flexible one (0: none).

    Cost: each takes one pass over the log."""
    no_substitute: float = 0.5
    """What a flexible effect and a second one leave, over what a plain one and its second leave, below which
    the plain one is no substitute.

    Half: where the flexible one only took an imperfection along, both pairs leave nearly the same."""
    cancelling: float = 2.0
    """Deviations of the whole machine from nominal above which an effect alone is undone by other parameters.

    Causes that oppose each other may make one larger than the whole, hardly twice as large."""
    holds: float = 0.7
    """Part of an effect's gain that a shape must lose with the effect to hold it.

    Simulated machines: a shape of limited resolution does not hold all of an effect."""
    used_up: float = 0.6
    """Part of the shape that holds an effect which the effect must use up to stay.

    Simulated machines with effects that no catalogue lists: a cause uses up all but chance, a look-alike the
    squared correlation of their shapes."""

    # validation on the holdout runs

    fewest_judges: int = 6
    """Judging runs below which the shrinkage has no interval: Student's t of fewer is wider than the gap.

    At 6 runs it is 2.6 standard errors, at 4 it is 3.2, and the error itself is known to a factor of 2."""
    bent: float = 0.5
    """Squares that an exact refit leaves, over those of its score, below which the score is no evidence.

    Half: such an effect (clipping) is judged by its decrease on the judging runs instead."""

    # verdict

    floor_known: float = 0.03
    """Relative uncertainty of a noise floor.

    A standard deviation from n samples is known to 1 / sqrt(2 n): 3 % is 560 samples at rest."""
    shape_certain: float = 0.05
    """P-value, corrected for all shapes, below which a shape alone is a gap.

    The false alarms accepted per log."""
    shape_likely: float = 0.02
    """P-value of one shape below which it supports an excess over a stated floor.

    The excess is evidence too, so the shape need not be certain."""
    unstructured: float = UNSTRUCTURED
    """Relative excess over a stated floor above which it is a gap although nothing in it has a shape; by
    which an estimated floor must exceed what the effects leave to be lowered to that.

    A choice: noise is often stated from a recording at rest and is larger in motion."""
    excess_errors: float = 2.0
    """Standard errors by which a metric must exceed a stated floor for an excess without a shape.

    Noise with a long memory makes the rms of a few short runs scatter: 2.3 % of them lie beyond 2."""
    closes: float = 0.9
    """Part of the excess that named effects must close for `explained` where something with a shape is left.

    Of a gap of twice the floor, a tenth of the excess is 14 % above the floor: a gap of its own."""

    partly: float = 0.5
    """Part of the excess from which on effects that close it, and leave a shape, explain the gap partly.

    Half: more is explained than not. Below, what is named is the smaller part of an unexplained gap."""

    # flexible alternatives: "behaves like"

    behaves_like: float = 0.1
    """Rms that a free variation of an effect must have, over what the effect makes, to be material.

    A tenth: simulated and independent machines with an effect of the catalogue stay below."""
    beaten: float = 0.001
    """P-value, corrected for the alternatives tried, below which a flexible alternative beats an effect.

    A tenth of what makes an effect certain: it speaks against a cause that the log supports."""
    own_coordinate: float = 0.95
    """Part of a contribution that gains and offsets over a coordinate must make for it to be a function of
    that coordinate.

    Other coordinates are other causes; what the fit of a polynomial leaves of a smooth function is less."""
    fewest_folds: int = 6
    """Fitted runs from which on an effect is held against a flexible alternative.

    Student's t of five folds and fewer says little below 1 %."""

    # confusable effects, and recordings that separate them

    separated: float = 5.0
    """Standard deviations of a slow average at which two effects are told apart.

    The convention of 5 sigma."""
    most_in_set: int = 3
    """Effects that a set may have which stands beside selected effects.

    An eccentricity in any direction is as many: offset, gain and angle of the axes. More explain anything."""
    nearly_linear: float = 0.02
    """Part of what the selected effects explain that a set may miss to first order and be refitted exactly.

    An effect of a tenth of the reading changes by a tenth to second order: a hundredth of its squares."""
    reason: float = 20.0
    """Difference of BIC from which on unneeded parameters make an effect no competitor of a plainer one.

    Twice the 10 that Kass and Raftery (1995) call very strong."""
    smallest: float = 0.1
    """Part of the threshold from which on a smaller finding is listed.

    With many samples anything is significant, such as reference noise that computed rates share."""
    most_runs: int = 100
    """Runs above which a separating recording is not proposed. A choice: a day of recording."""
    nearly_best: float = 0.7
    """Part of the best recording's separation from which on the plainest recording is proposed.

    A choice: half as many samples again buy a plainer recording."""

    # comparison of two records

    changed: float = 0.05
    """Familywise probability of calling a parameter changed that is not (Bonferroni). The usual 5 %."""
    floors_differ: float = 1.2
    """Ratio of two noise floors from which on a comparison notes it. A choice."""


POLICY = Policy()
"""The thresholds of `diagnose`."""
