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

    # levels and shares that several decisions have in common

    false_alarm: float = 0.05
    """Probability of a statement about a log in which nothing is, all that was tried counted: for a
    shape without a name, a place where a gap lies, and a parameter that changed between two records.

    The usual 5 %."""
    certain: float = 0.01
    """Corrected p-value below which an effect, a fault or a smaller finding is certain.

    The usual 1 %."""
    beyond_doubt: float = 0.001
    """Corrected p-value below which a flexible alternative beats an effect that is certain itself, and
    a single run, or the excess as a whole, is named.

    A tenth of what makes an effect certain: it speaks against a cause that the log supports."""
    negligible: float = 0.03
    """Share below which nothing is a finding: of what a best effect explains and a plainer one leaves,
    of an excess, of the largest wave.

    Below the 5 % that are worth reporting: what is left out is no finding."""
    minor: float = 0.1
    """Share up to which a part is minor: of the excess that named effects leave open in a gap that is
    explained, of a contribution that a flexible alternative makes otherwise, of the threshold that a
    smaller finding is worth.

    Of a gap of twice the floor, a tenth of the excess is 14 % above the floor: a gap of its own."""
    half: float = 0.5
    """Part from which on something is the larger one: of the threshold from which on a first, certain
    effect is taken up, that a refit must keep of its score, and that a likely shape or a line must
    explain; of the excess that effects close which explain a gap partly; of far samples that have
    others around them.

    A majority. An effect may be worth twice as much on the holdout runs, which decide."""
    mostly: float = 0.7
    """Part of a shape that must go with an effect for the shape to hold it, of the best recording's
    separation from which on the plainest one is proposed, of a curve that one sensor makes if it is
    named; of the usual scatter of a spectrum's power, below which a line is steady.

    Simulated machines: a shape of limited resolution does not hold all of an effect."""
    fewest: int = 6
    """Runs, or units of time, from which on their scatter says something: for an interval of the
    shrinkage, a flexible alternative, signs, a single run among others.

    Student's t of 6 is 2.6 standard errors wide, of 4 it is 3.2, and the error is known to a factor of
    2."""

    # input: which runs judge, and which gap counts

    worth_reporting: float = 0.05
    """Relative decrease of the gap metric from which on a gap is worth reporting.

    A choice; the user (--threshold) or the log (meta.json) may state another."""
    holdout_every: int = 5
    """One run of so many is held out where neither the user nor the log names holdout runs.

    A fifth of the runs judges, as in 5-fold cross-validation."""
    fewest_runs: int = 3
    """Runs below which a recording is split. Two to fit, so that one checks the other, and one to
    judge."""

    # screening and selection

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
    simpler_gap: float = 0.01
    """Relative gap by which an effect with fewer parameters may be worse than the best and be
    preferred.

    Below the 5 % that are worth reporting: what it leaves out is no finding."""
    as_good: float = 10.0
    """Difference of BIC up to which a variant with as few parameters as another effect explains as
    much; at twice that, unneeded parameters make an effect no competitor of a plainer one.

    What Kass and Raftery (1995) call very strong."""
    plain_pairs: int = 2
    """Plain effects that, each with a second effect, compete with a flexible one (0: none).

    Cost: each takes one pass over the log."""
    cancelling: float = 2.0
    """Deviations of the whole machine from nominal above which an effect alone is undone by other
    parameters.

    Causes that oppose each other may make one larger than the whole, hardly twice as large."""
    used_up: float = 0.6
    """Part of the shape that holds an effect which the effect must use up to stay.

    Simulated machines with effects that no catalogue lists: a cause uses up all but chance, a
    look-alike the squared correlation of their shapes."""

    # validation on the holdout runs

    # verdict

    floor_known: float = 0.03
    """Relative uncertainty of a noise floor.

    A standard deviation from n samples is known to 1 / sqrt(2 n): 3 % is 560 samples at rest."""
    shape_likely: float = 0.02
    """P-value of one shape below which it supports an excess over a stated floor.

    The excess is evidence too, so the shape need not be certain."""
    unstructured: float = UNSTRUCTURED
    """Relative excess over a stated floor above which it is a gap although nothing in it has a shape;
    by which an estimated floor must exceed what the effects leave to be lowered to that.

    A choice: noise is often stated from a recording at rest and is larger in motion."""
    excess_errors: float = 2.0
    """Standard errors by which a metric must exceed a stated floor for an excess without a shape.

    Noise with a long memory makes the rms of a few short runs scatter: 2.3 % of them lie beyond 2."""

    # flexible alternatives: "behaves like"

    own_coordinate: float = 0.95
    """Part of a contribution that gains and offsets over a coordinate must make for it to be a function
    of that coordinate.

    Other coordinates are other causes; what the fit of a polynomial leaves of a smooth function is
    less."""

    # confusable effects, and recordings that separate them

    separated: float = 5.0
    """Standard deviations of a slow average at which two effects are told apart.

    The convention of 5 sigma."""
    most_in_set: int = 3
    """Effects that a set may have which stands beside selected effects.

    An eccentricity in any direction is as many: offset, gain and angle of the axes. More explain
    anything."""
    nearly_linear: float = 0.02
    """Part of what the selected effects explain that a set may miss to first order and be refitted
    exactly.

    An effect of a tenth of the reading changes by a tenth to second order: a hundredth of its
    squares."""
    most_runs: int = 100
    """Runs above which a separating recording is not proposed. A choice: a day of recording."""

    # comparison of two records


POLICY = Policy()
"""The thresholds of `diagnose`."""
