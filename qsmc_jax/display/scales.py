"""When a range of numbers is better taken in the logarithm."""

_DECADE = 10.0


def spans_decade(low: float, high: float) -> bool:
    """Whether both ends are positive and more than a decade apart."""
    return bool(low > 0.0 and high > _DECADE * low)
