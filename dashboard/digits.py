"""Numbers as a page shows them: some digits, and no exponent where the number can be read."""

_LARGEST = 1e6


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits; from a million on with an exponent."""
    text = f"{value:.{digits}g}"
    return f"{float(text):.0f}" if "e+" in text and abs(value) < _LARGEST else text
