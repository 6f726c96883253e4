"""Running a file of Python that a user wrote, as the module that it would be if it were imported."""

import sys
import types
from typing import Any

# Always the same, since it is part of the names of the classes that the file defines.
_NAME = "qsmc_study"


def run_script(program: types.CodeType, file: str) -> dict[str, Any]:
    """The names that a program defines.

    It is known as a module while it runs and afterwards: dataclasses and annotations that are texts look there for what
    they name.

    Args:
        program: The program, compiled.
        file: Its `__file__`.
    """
    module = types.ModuleType(_NAME)
    module.__file__ = file
    sys.modules[_NAME] = module
    exec(program, vars(module))
    return vars(module)
