"""The errata of the consensus paper that the project's study lists, by its numbers."""

from concord.papers.kit.claims import Erratum

ERRATA = (
    Erratum(1, "(3)", "a trailing factor m/Ns", "it is the unit; the function is 1/(ms + b)"),
    Erratum(
        2, "after (7)", "states (x1, y1) and their derivatives; gamma is non-linear",
        "y2 = dy1/dt - (b2/M2) x1 + s y1 + (b2/M2) gamma; gamma enters linearly",
    ),
    Erratum(
        3, "(10)", "psi_a2 = 1/(mu - G_l); - psi_a3 delta",
        "psi_a2 = 1/mu - G_l, for c2 = c7 needs mu sigma psi_a2 near 1; the sign of psi_a3 "
        "contradicts c3 = +.232: - G_w sin(gamma) theta + G_l delta",
    ),
    Erratum(
        4, "(11)", "psi_q3 = eta G_w sin(gamma)",
        "it vanishes in level flight, and c6 = .0203 does not; G_t is defined and never used",
    ),
    Erratum(5, "(14)", ".177", ".17742"),
    Erratum(6, "(18)", "T theta'' + b theta", "J theta'' + b theta'"),
    Erratum(7, "(21)", "-R/J; a state theta for theta'", "-R/L; theta'"),
    Erratum(
        8, "III, VI", "position poles -100 +- 100i, -200 with t_s = .01 s and this motor",
        "place exp(p t_s); for this motor -5 +- i, -15 ask for 195 V per rad instead of 458 kV",
    ),
    Erratum(
        9, "VI", "nominal control 500 N",
        "the value that holds 10 m/s in open loop; N-bar r asks for 15 kN",
    ),
    Erratum(
        10, "(22), (23), (25), (26), IV",
        "integral of e dy; C(s) with E(s) in it; (25) labelled V/R; V/U; the lag on the right",
        "integral of e dt; C(s) without E(s); (25) is the open loop without Kp; V/R; zero and "
        "pole of a lag are on the left",
    ),
    Erratum(11, "(28)", "i = 0, ..., 2L + 1", "i = 0, ..., 2n; L is the number of iterations"),
    Erratum(12, "(alpha 3)-(alpha 8)", "one W", "W^(m) for means, W^(c) for covariances"),
    Erratum(13, "(alpha 4), (alpha 7)", "no Q, no R", "+ Q in (alpha 4), + R in (alpha 7)"),
    Erratum(
        14, "(alpha 5)", "propagated points used again",
        "draw them anew, or Q is not in the spread",
    ),
    Erratum(
        15, "(alpha 8), (alpha 10), (beta 1)", "y^(i) - x; z = y - y^(i); W for gain and weights",
        "y^(i) - y predicted; z = y - y predicted; another letter for the gain",
    ),
    Erratum(
        16, "2) of V", "x^i_n = x^i_{n,0}, P^i_{n,0} = P^i_{n,0}",
        "x^i_{n,0} = x^i_n, P^i_{n,0} = P^i_n",
    ),
    Erratum(
        17, "(beta 3)-(beta 5)", "l = 0, ..., l; x_{n+l}; points of before",
        "L averages; x_{n,L}; draw the points anew from the fused pair, + Q",
    ),
    Erratum(
        18, "after (31)", "Π = π^(1,j) R^n; v1 x^1 + v1 x^2 + ...",
        "Π = [π^ij], N x N, row-stochastic and primitive; sum of v_j x^j; v = 1/N if and only if "
        "doubly stochastic",
    ),
    Erratum(
        19, "table of VI", "a row without a name; Q = p H'H, R = 1; Q = 10 I, R = .05",
        "it is the bus; the first are weights of the LQR, the second 3 m and 22 cm; "
        "noise='matched' has physical ones",
    ),
    Erratum(
        20, "VI", "v of a unique distribution in (0, 1), and randn; P0 = 50 I solves the Riccati "
        "equation", "normal; it does not",
    ),
    Erratum(21, "Figs. 11, 12, 14", "x3 = phi; (b) twice; speed", "y1; (a), (b); position"),
    Erratum(
        22, "VI", "(nothing)",
        "N, graph, Π, l and the sensors of the nodes: without them no distributed result of the "
        "paper can be repeated",
    ),
    Erratum(
        23, "III, N-bar", "inv(A, B; C, D) gives N-bar, with the C of (21)",
        "with the two rows of C the matrix is not square: the controlled row alone; with the "
        "integrator of the bus there is no N-bar",
    ),
)  # fmt: skip
