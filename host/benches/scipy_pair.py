#!/usr/bin/env python3
"""Times scipy.optimize.least_squares on the thesis-size identification beside thermokin's, from the same numbers, in one run.

    cargo bench -p thermokin --bench identify --no-run
    python3 host/benches/scipy_pair.py          # needs numpy and scipy

scipy gets the analytic Jacobian, vectorised over all poses and targets in numpy.
"""
import json
import pathlib
import statistics
import subprocess
import tempfile
import time

import numpy as np
from scipy.optimize import least_squares

ROOT = pathlib.Path(__file__).resolve().parents[2]
H = np.pi / 2
# The thesis's table 4.1; one row a transform: which of d, theta, a, alpha, b, beta are parameters, and their values.
CHAIN = [
    ("theta a alpha beta", [-H, -2.0, np.pi, 0.0]),
    ("d theta a alpha", [-0.55, 0.0, 0.4, H]),
    ("theta a alpha beta", [-H, 0.86, np.pi, 0.0]),
    ("d theta a alpha", [0.0, H, 0.21, -H]),
    ("d theta a alpha", [-0.76158, 0.0, 0.0, -H]),
    ("d theta a alpha", [0.0, 0.0, 0.0, H]),
    ("d theta a alpha b beta", [-0.21, np.pi, 0.0, np.pi, 0.0, 0.0]),
]
SYMBOLS = ["d", "theta", "a", "alpha", "b", "beta"]
AXIS = {"d": 2, "theta": 2, "a": 0, "alpha": 0, "b": 1, "beta": 1}
TURNS = {"theta", "alpha", "beta"}
SIGMA = 4e-6


class Problem:
    """All points at once: rows of joints, targets in the flange frame, measured positions."""

    def __init__(self, table):
        self.q, self.target, self.measured = table[:, :6], table[:, 6:9], table[:, 9:]
        self.nominal = np.concatenate([values for _, values in CHAIN])

    def forward(self, x):
        """The predicted points, and for each parameter its axis and a point on it."""
        n = len(self.q)
        rotation = np.broadcast_to(np.eye(3), (n, 3, 3)).copy()
        origin = np.zeros((n, 3))
        axes, through, turning = [], [], []
        place = 0
        for number, (names, _) in enumerate(CHAIN):
            own = names.split()
            for symbol in SYMBOLS:
                if symbol not in own and not (symbol == "theta" and number > 0):
                    continue
                value = np.full(n, x[place] if symbol in own else 0.0)
                if symbol == "theta" and number > 0:
                    value = value + self.q[:, number - 1]
                axis = rotation[:, :, AXIS[symbol]]
                if symbol in own:
                    axes.append(axis.copy())
                    through.append(origin.copy())
                    turning.append(symbol in TURNS)
                    place += 1
                if symbol in TURNS:
                    c, s = np.cos(value), np.sin(value)
                    first, second = (AXIS[symbol] + 1) % 3, (AXIS[symbol] + 2) % 3
                    u, w = rotation[:, :, first].copy(), rotation[:, :, second].copy()
                    rotation[:, :, first] = c[:, None] * u + s[:, None] * w
                    rotation[:, :, second] = c[:, None] * w - s[:, None] * u
                else:
                    origin = origin + axis * value[:, None]
        points = origin + np.einsum("nij,nj->ni", rotation, self.target)
        return points, np.array(axes), np.array(through), np.array(turning)

    def residual(self, x):
        return ((self.forward(x)[0] - self.measured) / SIGMA).ravel()

    def jacobian(self, x):
        points, axes, through, turning = self.forward(x)
        columns = np.where(turning[:, None, None], np.cross(axes, points[None] - through), axes)
        return (columns / SIGMA).reshape(len(axes), -1).T


def thermokin():
    """Median and fastest time of the criterion benchmark, seconds, and the folder of the exported problem."""
    name = "15 poses, 4 targets, 30 parameters"
    subprocess.run(
        ["cargo", "bench", "-q", "-p", "thermokin", "--bench", "identify", "--", name, "--measurement-time", "3"],
        cwd=ROOT, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    target = json.loads(subprocess.run(["cargo", "metadata", "--format-version", "1", "--no-deps"], cwd=ROOT, check=True,
                                       capture_output=True, text=True).stdout)["target_directory"]
    sample = json.loads((pathlib.Path(target) / "criterion" / name / "new" / "sample.json").read_text())
    times = [total / count * 1e-9 for total, count in zip(sample["times"], sample["iters"])]
    return statistics.median(times), min(times)


def main():
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run(["cargo", "bench", "-q", "-p", "thermokin", "--bench", "identify", "--", "--export", folder],
                       cwd=ROOT, check=True, stderr=subprocess.DEVNULL)
        table = np.loadtxt(pathlib.Path(folder) / "thesis_size.csv", delimiter=",", skiprows=1)
    problem = Problem(table)
    check = np.random.default_rng(1).normal(size=30) * 1e-3 + problem.nominal
    step = 1e-6
    numeric = np.array([(problem.residual(check + step * e) - problem.residual(check - step * e)) / (2 * step)
                        for e in np.eye(30)]).T
    worst = np.abs(problem.jacobian(check) - numeric).max() / np.abs(numeric).max()
    assert worst < 1e-6, f"the Jacobian given to scipy is wrong by {worst}"
    times = []
    for _ in range(50):
        begun = time.perf_counter()
        found = least_squares(problem.residual, problem.nominal, problem.jacobian, method="lm", x_scale="jac",
                              ftol=1e-12, xtol=1e-12, gtol=1e-12)
        times.append(time.perf_counter() - begun)
    ours, fastest = thermokin()
    theirs = statistics.median(times)
    print(f"scipy {found.nfev} evaluations, loss {found.cost:.3f}")
    print(f"scipy      median {theirs * 1e6:9.0f} µs, fastest {min(times) * 1e6:9.0f} µs")
    print(f"thermokin  median {ours * 1e6:9.0f} µs, fastest {fastest * 1e6:9.0f} µs")
    print(f"ratio      median {theirs / ours:9.0f},    fastest {min(times) / fastest:9.0f}")


if __name__ == "__main__":
    main()
