"""Colours: one meaning each, told apart by the colour-blind, dark or light.

Source: Okabe, Ito (2008), Color Universal Design, the palette of eight colours. The other colours
were searched for: any two meanings differ by 10 or more (CIEDE2000) for each kind of sight.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Colour = tuple[int, int, int]

ORANGE: Colour = (230, 159, 0)
SKY: Colour = (86, 180, 233)
GREEN: Colour = (0, 158, 115)
YELLOW: Colour = (240, 228, 66)
VERMILION: Colour = (213, 94, 0)
PINK: Colour = (204, 121, 167)


QUIET_BUTTON: Colour = (72, 80, 92)
"""Of buttons that are not the first thing to press."""


class Theme(NamedTuple):
    """The colours of everything; `lines` to `faint` are shades of the text on the background."""

    dark: bool
    text: Colour
    quiet: Colour
    faint: Colour
    panel: Colour
    edge: Colour
    grid: Colour
    grid_section: Colour
    seeing: Colour
    blind: Colour
    stale: Colour
    sending: Colour
    down: Colour
    truth: Colour
    fused: Colour
    estimate: Colour
    selection: Colour


DARK = Theme(
    dark=True,
    text=(220, 222, 226),
    quiet=(150, 156, 168),
    faint=(56, 60, 70),
    panel=(36, 36, 36),
    edge=(110, 104, 92),
    grid=(40, 44, 54),
    grid_section=(58, 64, 78),
    seeing=SKY,
    blind=(45, 105, 150),
    stale=(176, 202, 176),
    sending=ORANGE,
    down=VERMILION,
    truth=YELLOW,
    fused=GREEN,
    estimate=PINK,
    selection=(255, 255, 255),
)
LIGHT = Theme(
    dark=False,
    text=(30, 34, 42),
    quiet=(98, 104, 116),
    faint=(222, 226, 233),
    panel=(255, 255, 255),
    edge=(166, 174, 166),
    grid=(236, 238, 242),
    grid_section=(214, 218, 226),
    seeing=(64, 131, 239),
    blind=(150, 178, 200),
    stale=(124, 72, 46),
    sending=ORANGE,
    down=VERMILION,
    truth=(20, 20, 20),
    fused=GREEN,
    estimate=(190, 90, 150),
    selection=(0, 60, 150),
)


def css(colour: Colour, opacity: float = 1.0) -> str:
    """A colour as CSS."""
    red, green, blue = colour
    if opacity < 1.0:
        return f"rgba({red},{green},{blue},{opacity:g})"
    return f"#{red:02x}{green:02x}{blue:02x}"


def mixed(one: Colour, other: Colour, share: float) -> Colour:
    """Between two colours: `share` of the first."""
    blend = [round(share * a + (1 - share) * b) for a, b in zip(one, other, strict=True)]
    return blend[0], blend[1], blend[2]


def letters_on(ground: Colour) -> Colour:
    """Black or white, whichever can be read on a colour."""
    light = relative_luminance(ground)
    # The contrast of both is equal where (light + 0.05)^2 is 1.05 times 0.05.
    return (0, 0, 0) if light > 0.179 else (255, 255, 255)


def ink(theme: Theme, colour: Colour) -> str:
    """Return a colour as CSS for a text on a panel, nearer to that of texts where it is too faint.

    Source: WCAG 2.2, 1.4.3: a contrast of 4.5.
    """
    ground = relative_luminance(theme.panel) + 0.05
    for share in np.linspace(1.0, 0.0, 21):
        found = mixed(colour, theme.text, float(share))
        light = relative_luminance(found) + 0.05
        if max(light / ground, ground / light) >= 4.6:
            return css(found)
    return css(theme.text)


def relative_luminance(colour: Colour) -> float:
    """Light of a colour, from 0 of black to 1 of white. Source: WCAG 2.2, relative luminance."""
    return float(np.array([0.2126, 0.7152, 0.0722]) @ linear(colour)) / 255


def linear(colours: object) -> NDArray[np.uint8]:
    """Bytes that three.js shows as these sRGB colours (..., 3), where it takes them for linear.

    So it does with colours per instance and per vertex. Source: IEC 61966-2-1.
    """
    share = np.asarray(colours, dtype=np.float64) / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    return (255 * light).round().astype(np.uint8)
