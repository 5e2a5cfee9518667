"""Numbers as a page shows them: some digits, and no exponent where the number can be read."""

import numpy as np

_LARGEST = 1e6


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits; from a million on with an exponent."""
    text = f"{value:.{digits}g}"
    if not np.isfinite(value) or not 1e3 <= abs(value) < _LARGEST:
        return text
    return grouped(f"{float(text):.{max(0, digits - 1 - int(np.log10(abs(value))))}f}")


def grouped(number: str) -> str:
    """Return a number in digits with a thin space between thousands, from five digits on."""
    whole, dot, rest = number.partition(".")
    if len(whole.lstrip("-")) < 5:
        return number
    return f"{int(whole):,}".replace(",", "\u202f") + dot + rest
