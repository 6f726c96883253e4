"""How the solve of a run ended."""

import enum


@enum.unique
class Outcome(enum.IntEnum):
    """How the solve of one run ended; `advice` says what to do about it.

    Examples:
        >>> import qsmc_jax as qj
        >>> outcome = qj.Outcome(0)
        >>> outcome.name, outcome.advice
        ('COMPLETED', 'Solved to the end of the horizon.')
    """

    COMPLETED = 0
    LEFT_FUNNEL = 1
    STARTED_OUTSIDE = 2
    BAD_PARAMETERS = 3
    MAX_STEPS = 4
    STEP_TOO_SMALL = 5
    BEYOND_RESOLUTION = 6
    LOST = 7
    QUEUE_FULL = 8
    UNRESOLVED = 9
    SOLVES_DISAGREE = 10
    DRIFTED = 11

    @property
    def advice(self) -> str:
        """What happened and what to do, in a sentence."""
        return _ADVICE[self]


_ADVICE = {
    Outcome.COMPLETED: "Solved to the end of the horizon.",
    Outcome.LEFT_FUNNEL: "The sliding variable reached the funnel's edge where the input does not push back: look at "
    "`least_gain` (a wrong `gain_sign`, or a gain that vanishes) for the broken premise; or a law was at its limit, "
    "or the reference jumped.",
    Outcome.STARTED_OUTSIDE: "The start is not inside the funnel, |sigma(0)| >= rho(0): enlarge `rho0` or move `x0`.",
    Outcome.BAD_PARAMETERS: "A drawn parameter breaks a premise: rho0, mu and rho_inf must be positive, and the "
    "surface Hurwitz; or a distribution has arguments out of range in this run, such as `low` not below `high`.",
    Outcome.MAX_STEPS: 'Gave up after `max_steps` steps. Try a larger `max_steps`, or `method="rodas5p"` for a '
    "stiff loop.",
    Outcome.STEP_TOO_SMALL: "The step size fell to the resolution of time: the drift, gain, reference or disturbance "
    "is not finite, or jumps in the state where the run sticks (`qj.smoothed` has friction that does not).",
    Outcome.BEYOND_RESOLUTION: "Came closer to the funnel's edge than float64 resolves, with the input still pushing "
    "back: the disturbance or drift is huge against the gain.",
    Outcome.LOST: "Got a thousand funnel widths away, and was not followed further, so that later claims are open "
    "unless they were broken before: sample faster, or allow more input.",
    Outcome.UNRESOLVED: "What the drift, gain, disturbance or reference may do within the shortest step could not be "
    "ruled out: one has no bound there, or the reference jumps and the plant with it.",
    Outcome.QUEUE_FULL: "The delay is longer than the samples that can be under way: raise `queue` of the "
    "`Implementation` above the delay over the period.",
    Outcome.SOLVES_DISAGREE: "One solve says that the run held and another that it was violated, and no two "
    "independent ones agree: lower `rtol`, and look for something short in time.",
    Outcome.DRIFTED: "What the state and the funnel coordinate say of the sliding variable differs by more than "
    "1e-3 of the funnel, or than the margin: lower `rtol`.",
}
