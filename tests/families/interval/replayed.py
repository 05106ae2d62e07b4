"""Plant and bounds stepped by matrix exponentials of scipy, written out anew from (12), (13) of Efimov2016."""

import numpy as np
from scipy.linalg import expm


def parts(M):
    return np.maximum(M, 0), np.maximum(-M, 0)


def split(Q):
    rest = Q - np.diag(np.diag(Q))
    return np.diag(np.diag(Q)) + np.maximum(rest, 0), np.maximum(-rest, 0)


def box_of(M, low, high):
    plus, minus = parts(M)
    return plus @ low - minus @ high, plus @ high - minus @ low


class Bounds:
    """x, z_lower, z_upper from a box of x(0); `d_box`, `v_box` are (lower, upper) or zeros."""

    def __init__(self, A, C, S, L, d_box=None, v_box=None, cut=()):
        self.A, self.C, self.S, self.L = (np.array(M, dtype=float) for M in (A, C, S, L))
        self.R = np.linalg.inv(self.S)
        n, p = self.A.shape[0], self.C.shape[0]
        self.d_box = d_box or (np.zeros(n), np.zeros(n))
        self.v_box = v_box or (np.zeros(p), np.zeros(p))
        self.Q0, self.Q1, self.cut = self.S @ self.A @ self.R, -self.S @ self.L @ self.C @ self.R, cut

    def start(self, x, low, high):
        self.x = np.array(x, dtype=float)
        self.lower, self.upper = box_of(self.S, np.array(low, dtype=float), np.array(high, dtype=float))
        return self

    def sample(self, v):
        y = self.C @ self.x + v
        for i, G in self.cut:
            inner = G @ y + np.array(box_of(-G[None], *self.v_box))[:, 0]
            self.lower[i], self.upper[i] = max(self.lower[i], inner[0]), min(self.upper[i], inner[1])
        (P1, N1), SL = split(self.Q1), self.S @ self.L
        low_d, up_d = box_of(self.S, *self.d_box)
        low_v, up_v = box_of(-SL, *self.v_box)
        self.g_lower = P1 @ self.lower - N1 @ self.upper + SL @ y + low_d + low_v
        self.g_upper = P1 @ self.upper - N1 @ self.lower + SL @ y + up_d + up_v

    def after(self, s, d):
        """x, x_lower, x_upper and the raw states a time s after the sample."""
        n = len(self.x)
        P, N = split(self.Q0)
        zero = np.zeros((n, n))
        flow = np.block([[self.A, zero, zero], [zero, P, -N], [zero, -N, P]])
        drive = np.concatenate([d, self.g_lower, self.g_upper])
        both = expm(np.block([[flow, drive[:, None]], [np.zeros((1, 3 * n + 1))]]) * s)
        state = (both @ np.concatenate([self.x, self.lower, self.upper, [1.0]]))[: 3 * n]
        x, lower, upper = state[:n], state[n : 2 * n], state[2 * n :]
        return x, *box_of(self.R, lower, upper), (x, lower, upper)

    def flow(self, s, d):
        self.x, self.lower, self.upper = self.after(s, d)[3]

    def margin(self, s, d):
        x, low, high, _ = self.after(s, d)
        return min((x - low).min(), (high - x).min())


def replay(bounds, witness):
    """The distance of the state from its bounds at the end of a witness's run."""
    from cdobs_cli.exact.numbers import Exact

    numbers = lambda texts: np.array([float(Exact(text)) for text in texts])  # noqa: E731
    data = witness.data
    bounds.start(numbers(data["state"]), numbers(data["lower"]), numbers(data["upper"]))
    lengths = [float(Exact(text)) for text in (*witness.times, data["after"])]
    n, p = len(bounds.x), len(bounds.C)
    for k, (length, d, v) in enumerate(zip(lengths, data["disturbance"], data["noise"], strict=True)):
        bounds.sample(numbers(v) if v else np.zeros(p))
        held = numbers(d) if d else np.zeros(n)
        if k == len(lengths) - 1:
            return bounds.margin(length, held)
        bounds.flow(length, held)
    raise AssertionError
