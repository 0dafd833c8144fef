#!/usr/bin/env python3
"""Draws the pictures of README.md and the guides again: a campaign in the terminal, a gate that fails, its replay, and the explorer.

    cargo build && python3 scripts/pictures.py
    python3 scripts/pictures.py --only verdict twin
    python3 scripts/pictures.py --only environment --python PYTHON_WITH_META_WORLD

A fresh gate with weak grippers fails, and a fresh run of the default campaign follows. All episodes have fixed seeds, so new pictures
differ only where RoboGate does. This needs chromium, ffmpeg and tmux.
"""

import argparse
import base64
import json
import os
import pathlib
import shutil
import subprocess
import tempfile
import time

import terminal_image

REPOSITORY = pathlib.Path(__file__).resolve().parent.parent
IMAGES = REPOSITORY / "docs" / "images"
# A grip force of 14 N per pad loses the heavy and the slippery parts of the suite.
GATE = ["gate", "--set", "grip_force_n=14", "--seed", "1", "--out", "gate"]
# Without its progress, whose rates are those of the machine.
# The expert of Meta-World fails in some of these episodes.
ENVIRONMENT = ["run", "--env", "metaworld:push-v3", "-n", "40", "--seed", "5", "--out", "environment", "--python"]
RUN, RUN_FOLDER = "robogate run --quiet", "runs/franka-quick-2026"
# Lines of the terminal: the rate, where it fails, and what to do.
RUN_LINES = 26
# Seconds of simulated time between two frames of the animation, frames per second, and frames of rest at its end.
STEP_S, FPS, REST = 0.16, 10, 12
# The height of the window. All pictures fit into it: a page is not laid out again for a picture.
WINDOW_PX = 2000
MOST_BYTES = 400_000


class Browser:
    """A headless Chromium, driven through a pipe."""

    def __init__(self, folder):
        theirs_in, ours_out = os.pipe()
        ours_in, theirs_out = os.pipe()
        options = ["--headless", "--no-sandbox", "--no-first-run", "--hide-scrollbars", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        command = [shutil.which("chromium") or "chromium", *options, "--remote-debugging-pipe", f"--user-data-dir={folder}/profile", "about:blank"]
        # Chromium reads requests from descriptor 3 and writes answers to descriptor 4.
        shell = ["bash", "-c", f'exec "$@" 3<&{theirs_in} 4>&{theirs_out}', "chromium", *command]
        self.process = subprocess.Popen(shell, pass_fds=(theirs_in, theirs_out), stderr=subprocess.DEVNULL)
        os.close(theirs_in)
        os.close(theirs_out)
        self.requests, self.answers = os.fdopen(ours_out, "wb"), os.fdopen(ours_in, "rb")
        self.last, self.session = 0, None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.kill()
        self.process.wait()

    def call(self, method, **parameters):
        """The result of a method of the DevTools protocol."""
        self.last += 1
        request = {"id": self.last, "method": method, "params": parameters}
        if self.session:
            request["sessionId"] = self.session
        self.requests.write(json.dumps(request).encode() + b"\0")
        self.requests.flush()
        while True:
            message = bytearray()
            while not message.endswith(b"\0"):
                byte = self.answers.read1(1)
                if not byte:
                    raise SystemExit("error: chromium ended. Expected a Chromium that can start headless")
                message += byte
            answer = json.loads(message[:-1])
            if answer.get("id") == self.last:
                if "error" in answer:
                    raise SystemExit(f"error: {method}: {answer['error']}")
                return answer["result"]

    def evaluate(self, expression):
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise SystemExit(f"error: {expression}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def wait(self, condition):
        end = time.monotonic() + 120
        while self.evaluate(condition) is not True:
            if time.monotonic() > end:
                raise SystemExit(f"error: the page did not fulfil `{condition}` within 120 s")
            time.sleep(0.1)

    def open(self, page, width, scale, condition):
        """Opens a page in the light theme, and waits for a condition."""
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=WINDOW_PX, deviceScaleFactor=scale, mobile=False)
        self.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "light"}])
        self.call("Page.navigate", url=page.as_uri())
        self.wait("document.readyState === 'complete'")
        self.wait(condition)
        self.settle()

    def settle(self):
        """Waits until the page has drawn the last change."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 50))))")

    def shot(self, file, box, **form):
        """Writes the part `box` (left, top, width, height in CSS pixels) of the page."""
        clip = dict(zip(("x", "y", "width", "height"), box), scale=1)
        answer = self.call("Page.captureScreenshot", clip=clip, **(form or {"format": "png"}))
        file.write_bytes(base64.b64decode(answer["data"]))


def run(robogate, folder, arguments, expected):
    """Runs the command, and checks its exit code."""
    done = subprocess.run([robogate / "robogate", *arguments], cwd=folder, capture_output=True, text=True)
    if done.returncode != expected:
        raise SystemExit(f"error: robogate {' '.join(arguments)}: exit code {done.returncode}, expected {expected}\n{done.stdout}{done.stderr}")


def few_colours(file):
    """Reduces a PNG to 256 colours, which halves its size."""
    small = file.with_suffix(".small.png")
    few = "split[a][b];[a]palettegen=stats_mode=full[p];[b][p]paletteuse=dither=none"
    subprocess.run(["ffmpeg", "-v", "error", "-y", "-i", file, "-lavfi", few, small], check=True)
    small.replace(file)


def verdict(browser, folder, file):
    browser.open(folder / "gate" / "report.html", 1140, 1.5, "!!document.querySelector('[data-ready]')")
    bottom = browser.evaluate("document.querySelector('.verdict').getBoundingClientRect().bottom")
    browser.shot(file, (0, 0, 1140, bottom + 16))
    few_colours(file)


def twin(browser, folder, file):
    browser.open(folder / "gate" / "report.html", 1140, 1, "!!document.querySelector('[data-ready]')")
    browser.wait("document.querySelectorAll('.view-label').length === 2")
    slider = "document.querySelector('.view-bar input[type=range]')"
    last = float(browser.evaluate(f"{slider}.max"))
    box = browser.evaluate("(() => { const b = document.querySelector('.view-stage').getBoundingClientRect(); return [b.left, b.top, b.width, b.height] })()")
    frames = folder / "frames"
    frames.mkdir()
    count = int(last / STEP_S) + 2
    for at in range(count):
        browser.evaluate(f"{slider}.value = {min(at * STEP_S, last)}; {slider}.dispatchEvent(new Event('input'))")
        browser.settle()
        browser.shot(frames / f"{at:03}.png", box)
    for at in range(count, count + REST):
        shutil.copy(frames / f"{count - 1:03}.png", frames / f"{at:03}.png")
    drawn = "scale=640:-1:flags=lanczos,split[a][b];[a]palettegen=max_colors=96:stats_mode=full[p];[b][p]paletteuse=dither=none:diff_mode=rectangle"
    subprocess.run(["ffmpeg", "-v", "error", "-y", "-framerate", str(FPS), "-i", frames / "%03d.png", "-lavfi", drawn, file], check=True)


def explorer(browser, folder, file):
    browser.open(folder / "explorer.html", 1280, 1, "document.body.dataset.modelled === 'true' && !robogateExplorer.explorer.awake")
    bottom = browser.evaluate("document.querySelector('.x-map').closest('section').getBoundingClientRect().bottom")
    browser.shot(file, (0, 0, 1280, bottom + 12), format="jpeg", quality=78)


def environment(browser, folder, file):
    browser.open(folder / "environment" / "report.html", 1140, 1.25, "!!document.querySelector('[data-ready]')")
    browser.wait("document.querySelectorAll('.view-label').length === 2")
    slider = "document.querySelector('.view-bar input[type=range]')"
    browser.evaluate(f"{slider}.value = 0.45 * {slider}.max; {slider}.dispatchEvent(new Event('input'))")
    browser.settle()
    box = browser.evaluate("(() => { const b = document.querySelector('.watch').getBoundingClientRect(); return [b.left - 8, b.top - 8, b.width + 16, 560] })()")
    browser.shot(file, box, format="jpeg", quality=80)


PICTURES = {"run": "run.png", "verdict": "verdict.png", "twin": "twin.gif", "explorer": "explorer.jpg", "environment": "environment.jpg"}
README = ["run", "verdict", "twin", "explorer"]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robogate", type=pathlib.Path, default=REPOSITORY / "target" / "debug", help="folder of the command (default: target/debug)")
    parser.add_argument("--only", nargs="+", choices=list(PICTURES), default=README, help="draw these only")
    parser.add_argument("--python", help="an interpreter with Meta-World, for the picture of an environment")
    arguments = parser.parse_args()
    robogate, only = arguments.robogate.resolve(), arguments.only
    with tempfile.TemporaryDirectory() as name, Browser(name) as browser:
        folder = pathlib.Path(name)
        if "verdict" in only or "twin" in only:
            run(robogate, folder, GATE, 1)
        if "environment" in only:
            if arguments.python is None:
                parser.error("--only environment needs --python, an interpreter with Meta-World")
            run(robogate, folder, [*ENVIRONMENT, arguments.python], 0)
        if "run" in only or "explorer" in only:
            lines = terminal_image.screen(RUN, 120, folder, f"{robogate}:{os.environ['PATH']}")
            run(robogate, folder, ["view", RUN_FOLDER, "--out", "explorer.html", "--clips", "4"], 0)
        if "run" in only:
            terminal_image.draw(IMAGES / "run.png", lines, 120, RUN_LINES)
            few_colours(IMAGES / "run.png")
        for picture in (verdict, twin, explorer, environment):
            if picture.__name__ in only:
                picture(browser, folder, IMAGES / PICTURES[picture.__name__])
    for file in sorted(IMAGES / PICTURES[name] for name in only):
        print(f"{file.relative_to(REPOSITORY)}: {file.stat().st_size:,} bytes")
        if file.stat().st_size > MOST_BYTES:
            raise SystemExit(f"error: {file.name} has more than {MOST_BYTES:,} bytes. Hint: draw fewer frames or lines")


if __name__ == "__main__":
    main()
