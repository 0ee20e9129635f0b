"""Draws the README's figures from what `thermokin ... --json` wrote. Standard library alone.

    cargo run --release -- calibrate host/data/ur10 --poses every:10 --out /tmp/ur10.json
    cargo run --release -- validate /tmp/ur10.json host/data/ur10 --json /tmp/by-pose.json
    python3 host/docs/figures.py poses /tmp/by-pose.json host/docs/errors-by-pose.svg

    for run in 75-25 90-30; do cargo run --release -- simulate thesis-$run --out /tmp/run-$run; done
    cargo run --release -- calibrate /tmp/run-75-25 --out /tmp/thermal.json
    cargo run --release -- validate /tmp/thermal.json /tmp/run-90-30 --json /tmp/by-cycle.json
    python3 host/docs/figures.py cycles /tmp/by-cycle.json host/docs/errors-by-cycle.svg
"""

import json
import sys

GREY, BLUE, RED, INK = "#9a9a9a", "#1f5fa8", "#c0392b", "#222222"
WIDTH, LEFT, RIGHT = 760, 64, 180


class Panel:
    """Axes with a frame, ticks and a title; turns data into places on the page."""

    def __init__(self, top, height, x_range, y_range):
        self.top, self.height, self.x_range, self.y_range = top, height, x_range, y_range
        self.parts = []

    def x(self, value):
        low, high = self.x_range
        return LEFT + (value - low) / (high - low) * (WIDTH - LEFT - RIGHT)

    def y(self, value):
        low, high = self.y_range
        return self.top + self.height - (value - low) / (high - low) * self.height

    def text(self, x, y, words, anchor="start", colour=INK, extra=""):
        self.parts.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}" fill="{colour}"{extra}>{words}</text>')

    def axes(self, x_ticks, y_ticks, x_title, y_title):
        bottom, right = self.top + self.height, WIDTH - RIGHT
        for tick in y_ticks:
            y = self.y(tick)
            self.parts.append(f'<path d="M{LEFT} {y:.1f}H{right}" stroke="#e4e4e4"/>')
            self.text(LEFT - 8, y + 4, f"{tick:g}", "end")
        for tick in x_ticks:
            self.parts.append(f'<path d="M{self.x(tick):.1f} {bottom}v5" stroke="{INK}"/>')
            if x_title:
                self.text(self.x(tick), bottom + 19, f"{tick:g}", "middle")
        self.parts.append(f'<path d="M{LEFT} {self.top}V{bottom}H{right}" fill="none" stroke="{INK}"/>')
        if x_title:
            self.text((LEFT + right) / 2, bottom + 38, x_title, "middle")
        middle = self.top + self.height / 2
        self.text(18, middle, y_title, "middle", extra=f' transform="rotate(-90 18 {middle:.1f})"')

    def dots(self, points, colour, size):
        d = "".join(f"M{self.x(x):.1f} {self.y(y):.1f}h0" for x, y in points)
        self.parts.append(f'<path d="{d}" stroke="{colour}" stroke-width="{size}" stroke-linecap="round" fill="none"/>')

    def line(self, points, colour, dash=""):
        d = "M" + "L".join(f"{self.x(x):.1f} {self.y(y):.1f}" for x, y in points)
        self.parts.append(f'<path d="{d}" stroke="{colour}" stroke-width="2" fill="none"{dash}/>')


def page(panels, height, title):
    parts = "\n".join(part for panel in panels for part in panel.parts)
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        f'font-family="sans-serif" font-size="13">\n<rect width="100%" height="100%" fill="white"/>\n'
        f'<text x="{LEFT}" y="24" font-size="15" fill="{INK}">{title}</text>\n{parts}\n</svg>\n'
    )


def mean(values):
    values = list(values)
    return sum(values) / len(values)


def by_pose(result):
    """Errors of the poses that the calibration did not use: it was given every tenth row."""
    poses = [pose for place, pose in enumerate(result["poses"]) if place % 10]
    hours = [pose["time_s"] / 3600 for pose in poses]
    panel = Panel(44, 300, (0, 101), (0, 2.75))
    panel.axes(range(0, 101, 20), [0, 0.5, 1, 1.5, 2, 2.5], "time, hours", "position error, mm")
    for key, words, colour in (("nominal_mm", "nominal", GREY), ("thermal_mm", "calibrated", BLUE)):
        errors = [pose[key] for pose in poses]
        panel.dots(zip(hours, errors), colour, 3)
        average = mean(errors)
        panel.line([(0, average), (101, average)], colour)
        panel.text(WIDTH - RIGHT + 8, panel.y(average) + 4, f"{words}: mean {average:.2f}", colour=colour)
    return page([panel], 400, f"UR10, measured: {len(poses)} poses that the calibration did not see")


def by_cycle(result):
    """Mean errors of the cycles of a run that the calibration did not see, above the temperature."""
    cycles = result["cycles"]
    hours = [cycle["time_s"] / 3600 for cycle in cycles]
    end = max(hours) * 1.02
    highest = max(cycle["geometric_mm"] for cycle in cycles)
    top = 0.2 * (int(highest / 0.2) + 1)
    errors = Panel(44, 220, (0, end), (0, top))
    ticks = [step for step in range(0, int(end) + 1)]
    errors.axes(ticks, [0.2 * step for step in range(int(top / 0.2 + 0.5) + 1)], "", "mean error, mm")
    for key, words, colour in (("geometric_mm", "geometric", RED), ("thermal_mm", "thermal", BLUE)):
        values = [cycle[key] for cycle in cycles]
        errors.line(list(zip(hours, values)), colour)
        errors.dots(zip(hours, values), colour, 7)
        errors.text(WIDTH - RIGHT + 8, errors.y(values[-1]) + 4, f"{words}: mean {mean(values):.2f}", colour=colour)
    nominal = mean(cycle["nominal_mm"] for cycle in cycles)
    errors.text(WIDTH - RIGHT + 8, errors.top + 12, f"nominal: mean {nominal:.2f}", colour=GREY)
    errors.text(WIDTH - RIGHT + 8, errors.top + 29, "(above the figure)", colour=GREY)
    warm = [cycle["temperature_c"] for cycle in cycles]
    low, high = 5 * int(min(warm) / 5), 5 * (int(max(warm) / 5) + 1)
    below = Panel(290, 80, (0, end), (low, high))
    below.axes(ticks, range(low, high + 1, 5), "time, hours", "mean °C")
    below.line(list(zip(hours, warm)), INK)
    return page([errors, below], 425, "Simulated run at 90 % and 30 % speed, not seen by the calibration")


def main():
    if len(sys.argv) != 4 or sys.argv[1] not in ("poses", "cycles"):
        sys.exit(__doc__)
    draw = {"poses": by_pose, "cycles": by_cycle}[sys.argv[1]]
    with open(sys.argv[2]) as source:
        figure = draw(json.load(source))
    with open(sys.argv[3], "w") as out:
        out.write(figure)


main()
