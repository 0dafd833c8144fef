#!/usr/bin/env python3
"""Runs a command in a terminal of tmux and draws the screen as a PNG, with a headless Chromium.

    python3 scripts/terminal_image.py docs/images/run.png 'robogate run' --columns 124

The command runs in an empty folder, with the folder of --robogate first on the PATH. The height of the picture follows from the text.
"""

import argparse
import html
import os
import pathlib
import re
import shutil
import struct
import subprocess
import tempfile
import time

STYLES = {"1": "font-weight:bold;color:#fff", "2": "opacity:.62", "31": "color:#ff7b72", "32": "color:#7ee787", "33": "color:#e3b341"}
PAGE = """<!doctype html><meta charset="utf-8"><style>html{{background:#16181d}}
body{{margin:20px 26px;color:#d7dae0;font:15px/20px 'DejaVu Sans Mono',monospace;white-space:pre}}</style>{}"""
LINE_PX, MARGIN_PX, COLUMN_PX = 20, 20, 9.05


def drawn(text):
    """HTML for text with SGR sequences."""
    active, out = [], []
    for piece in re.split(r"(\x1b\[[0-9;]*m)", text):
        codes = re.fullmatch(r"\x1b\[([0-9;]*)m", piece)
        if not codes:
            style = ";".join(STYLES[code] for code in active if code in STYLES)
            out.append(f'<span style="{style}">{html.escape(piece)}</span>' if style and piece else html.escape(piece))
            continue
        for code in codes[1].split(";"):
            active = [] if code in ("", "0") else [one for one in active if code != "39" or one[0] != "3"] + [code]
    return "".join(out)


def screen(command, columns, folder, path):
    """The screen after a command, with SGR sequences."""
    session = f"image-{os.getpid()}"
    environment = ["env", f"PATH={path}", "PS1=$ ", "TERM=xterm-256color", "bash", "--norc", "--noprofile"]
    subprocess.run(["tmux", "new-session", "-d", "-s", session, "-x", str(columns), "-y", "120", "-c", folder, *environment], check=True)
    try:
        done = pathlib.Path(folder) / ".done"
        time.sleep(1)
        subprocess.run(["tmux", "send-keys", "-t", session, f"clear; echo '$ {command}'; {command}; touch .done; sleep 5", "Enter"], check=True)
        while not done.exists():
            time.sleep(0.5)
        time.sleep(0.5)
        captured = subprocess.run(["tmux", "capture-pane", "-e", "-p", "-t", session], check=True, capture_output=True, text=True)
        return captured.stdout
    finally:
        subprocess.run(["tmux", "kill-session", "-t", session], check=False)


def draw(image, text, columns, most=None):
    """Draws a screen as a PNG: its first `most` lines, or all of them."""
    lines = text.rstrip().splitlines()
    while lines and not lines[0].strip():
        lines.pop(0)
    if most and len(lines) > most:
        lines = [*lines[:most], "\u2026"]
    with tempfile.TemporaryDirectory() as folder:
        page, shot = pathlib.Path(folder) / "page.html", pathlib.Path(folder) / "shot.png"
        page.write_text(PAGE.format(drawn("\n".join(lines))), encoding="utf-8")
        size = f"{round(columns * COLUMN_PX) + 52},{len(lines) * LINE_PX + 2 * MARGIN_PX}"
        chromium = shutil.which("chromium") or "chromium"
        subprocess.run(
            [chromium, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={folder}/profile",
             f"--window-size={size}", f"--screenshot={shot}", page.as_uri()],
            check=True, capture_output=True,
        )
        image.write_bytes(shot.read_bytes())
    width, height = struct.unpack(">II", image.read_bytes()[16:24])
    print(f"{image}: {width} x {height} pixels, {len(lines)} lines")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("image", type=pathlib.Path)
    parser.add_argument("command")
    parser.add_argument("--columns", type=int, default=110, help="width of the terminal (default: 110)")
    parser.add_argument("--robogate", default="target/release", help="folder of the command (default: target/release)")
    arguments = parser.parse_args()
    path = f"{pathlib.Path(arguments.robogate).resolve()}:{os.environ['PATH']}"
    with tempfile.TemporaryDirectory() as folder:
        text = screen(arguments.command, arguments.columns, folder, path)
    draw(arguments.image, text, arguments.columns)


if __name__ == "__main__":
    main()
