"""Numbers as a page shows them: some digits, and no exponent where the number can be read."""

_LARGEST = 1e6


def rounded(value: float, digits: int = 3) -> str:
    """Return a number with so many digits; from a million on with an exponent."""
    text = f"{value:.{digits}g}"
    return grouped(f"{float(text):.0f}" if "e+" in text and abs(value) < _LARGEST else text)


def grouped(number: str) -> str:
    """Return a number in digits with a thin space between thousands, from five digits on."""
    whole, dot, rest = number.partition(".")
    if not whole.lstrip("-").isdecimal() or len(whole.lstrip("-")) < 5:
        return number
    return f"{int(whole):,}".replace(",", "\u202f") + dot + rest
