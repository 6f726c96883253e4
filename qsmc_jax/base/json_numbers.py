"""JSON whose numbers stay numbers, also those that JSON does not know."""

import json
import math
from collections.abc import Mapping
from typing import Any

# In an object with infinite values: which, by name, and their sign.
INFINITE = "infinite"


def to_json(content: Mapping[str, Any]) -> str:
    """The content as one JSON document.

    What is unknown (NaN) and what is infinite becomes null. An object with infinite values has one more, `infinite`:
    their names with their signs, as in `{"reach_time": null, "infinite": {"reach_time": 1}}`.

    Args:
        content: Numbers, texts, and mappings and lists of such.
    """
    return json.dumps(_plain(content), indent=2, allow_nan=False)


def restored(content: Any) -> Any:
    """What was read from such a document, with its infinite numbers again; what is unknown stays None."""
    if isinstance(content, list):
        return [restored(item) for item in content]
    if not isinstance(content, dict):
        return content
    plain = {key: restored(item) for key, item in content.items() if key != INFINITE}
    for key, sign in content.get(INFINITE, {}).items():
        value = math.copysign(math.inf, sign)
        plain[key] = [value if item is None else item for item in plain[key]] if plain.get(key) else value
    return plain


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        infinite = {str(key): _sign(item) for key, item in value.items() if _sign(item)}
        plain = {str(key): _plain(item) for key, item in value.items()}
        return {**plain, INFINITE: infinite} if infinite else plain
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _sign(value: Any) -> int:
    """1 or -1 for an infinite number or a list with one, else 0."""
    if isinstance(value, list | tuple):
        return next((sign for sign in map(_sign, value) if sign), 0)
    return int(math.copysign(1.0, value)) if isinstance(value, float) and math.isinf(value) else 0
