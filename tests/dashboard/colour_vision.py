"""How colours look to the colour-blind, and how far two colours are apart."""

import numpy as np

# Source: Machado, Oliveira and Fernandes (2009), A physiologically-based model for simulation of
# color vision deficiency, IEEE TVCG 15(6), severity 1.0; of linear sRGB.
SIGHT = {
    "normal": np.eye(3),
    "protanopia": np.array([
        [0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ]),
    "deuteranopia": np.array([
        [0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ]),
    "tritanopia": np.array([
        [1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ]),
}  # fmt: skip
# Source: IEC 61966-2-1, sRGB to XYZ under D65.
_XYZ = np.array([
    [0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505],
])  # fmt: skip
_WHITE = np.array([0.95047, 1.0, 1.08883])


def lab(colour: tuple[int, int, int], sight: str) -> np.ndarray:
    """CIELAB (3,) of an sRGB colour of bytes, as a person with that sight sees it."""
    share = np.array(colour) / 255
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    relative = _XYZ @ np.clip(SIGHT[sight] @ light, 0, 1) / _WHITE
    f = np.where(relative > 216 / 24389, np.cbrt(relative), (24389 / 27 * relative + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def difference(one: np.ndarray, other: np.ndarray) -> float:
    """CIEDE2000 of two colours (3,) in CIELAB.

    Source: Sharma, Wu and Dalal (2005), The CIEDE2000 color-difference formula, Color Research and
    Application 30(1), equations 2 to 22.
    """
    chroma = (np.hypot(*one[1:]) + np.hypot(*other[1:])) / 2
    gain = 0.5 * (1 - np.sqrt(chroma**7 / (chroma**7 + 25**7)))
    a = np.array([one[1], other[1]]) * (1 + gain)
    b = np.array([one[2], other[2]])
    c, h = np.hypot(a, b), np.degrees(np.arctan2(b, a)) % 360
    turn = 0.0 if c.prod() == 0 else (h[1] - h[0] + 180) % 360 - 180
    d_light, d_chroma = other[0] - one[0], c[1] - c[0]
    d_hue = 2 * np.sqrt(c.prod()) * np.sin(np.radians(turn / 2))
    light, mean_c = (one[0] + other[0]) / 2, c.mean()
    mean_h = h.sum() if c.prod() == 0 else (h[0] + turn / 2) % 360
    t = (
        1 - 0.17 * _cos(mean_h - 30) + 0.24 * _cos(2 * mean_h) + 0.32 * _cos(3 * mean_h + 6)
        - 0.20 * _cos(4 * mean_h - 63)
    )  # fmt: skip
    s_light = 1 + 0.015 * (light - 50) ** 2 / np.sqrt(20 + (light - 50) ** 2)
    s_chroma, s_hue = 1 + 0.045 * mean_c, 1 + 0.015 * mean_c * t
    angle = np.radians(60 * np.exp(-(((mean_h - 275) / 25) ** 2)))
    r = -2 * np.sqrt(mean_c**7 / (mean_c**7 + 25**7)) * np.sin(angle)
    light_part, chroma_part, hue_part = d_light / s_light, d_chroma / s_chroma, d_hue / s_hue
    squares = light_part**2 + chroma_part**2 + hue_part**2 + r * chroma_part * hue_part
    return float(np.sqrt(squares))


def _cos(degrees: float) -> float:
    return float(np.cos(np.radians(degrees)))
