"""What the exit codes of the program mean: each one thing."""

HELD, VIOLATED, BAD_INPUT, UNDECIDED, INTERNAL_ERROR = 0, 1, 2, 3, 70
MEANING = "Exit codes: 0 held, or done; 1 violated; 2 bad input; 3 undecided or interrupted; 70 a defect of qsmc_jax."


def code_of(verdict: str) -> int:
    """The exit code of a verdict, by its name."""
    return {"HELD": HELD, "VIOLATED": VIOLATED}.get(verdict, UNDECIDED)
