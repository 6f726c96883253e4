"""What one run says about one claim."""

import enum


class Verdict(enum.IntEnum):
    """What one run says about one claim: one of Theorem 1, or a requirement of one's own.

    HELD and VIOLATED are findings. UNDECIDED means that the solve could not tell: it widens the interval both ways and
    is never dropped. INADMISSIBLE means that a premise (a start inside the funnel, C2, a Hurwitz surface) does not hold
    in that run.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.Verdict(1).name, int(qj.Verdict.UNDECIDED)
        ('VIOLATED', 2)
    """

    HELD = 0
    VIOLATED = 1
    UNDECIDED = 2
    INADMISSIBLE = 3
