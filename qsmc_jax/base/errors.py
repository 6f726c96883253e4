"""What is raised when an input is at fault, not the program."""


class InputError(ValueError):
    """An argument, a study or a file is not as it should be; the text names it, its value and what to do.

    It is a `ValueError`, so that whoever expects one of those is served too. What else the package raises is a defect.

    Examples:
        >>> import qsmc_jax as qj
        >>> try:
        ...     qj.Funnel(rho0=1.0, mu=-1.0, rho_inf=0.1)
        ... except qj.InputError as error:
        ...     print(error)
        Argument `mu` must be positive and finite, but is -1.
    """
