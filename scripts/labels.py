#!/usr/bin/env python3
"""Compares the failure modes of episodes with those of a second classifier, which sees recorded motion and contact forces alone.

The classifier follows the descriptions of the modes in docs/reference and shares no code with the referees. It reads /tf, /contacts,
/observation and /command of the MCAP file of each episode, and the parameters of its scenario; neither /measures nor /log.

Usage: scripts/labels.py ROBOGATE WORK [--failures N] [--episodes N] [--tasks pick_place,stacking,insertion]
Runs a campaign of each task in WORK, replays its first N failures, and prints the agreement and every disagreement. It needs
the Python package `mcap`. docs/results/labels.md has its results.
"""

import argparse
import collections
import csv
import json
import math
import pathlib
import subprocess

from mcap.reader import make_reader

# The limit of contact forces and the grip force of the Franka's hand, in newtons.
LIMIT_N, GRIP_N = 150.0, 30.0
JAM_N, JAM_S = 100.0, 0.05
# Contacts farther than this behind the tool centre point are those of the palm, in metres.
PALM_M = 0.025
# The link of the Franka that carries its hand.
WRIST = "robot/link7"
# The options of each task's campaign.
RUNS = {
    "pick_place": ["--space", "franka", "--design", "uniform"],
    "stacking": ["--design", "two-stage"],
    "insertion": ["--design", "two-stage"],
}


def rotate(q, v, inverse=False):
    """Rotates a vector by a quaternion w, x, y, z."""
    w, x, y, z = q
    if inverse:
        x, y, z = -x, -y, -z
    t = [2 * (y * v[2] - z * v[1]), 2 * (z * v[0] - x * v[2]), 2 * (x * v[1] - y * v[0])]
    return [
        v[0] + w * t[0] + y * t[2] - z * t[1],
        v[1] + w * t[1] + z * t[0] - x * t[2],
        v[2] + w * t[2] + x * t[1] - y * t[0],
    ]


def inverse(q):
    return [q[0], -q[1], -q[2], -q[3]]


def product(a, b):
    """The product of two quaternions."""
    return [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]


def minus(a, b):
    return [x - y for x, y in zip(a, b)]


def norm(v):
    return math.sqrt(sum(x * x for x in v))


def inside(tool, body):
    """Position of a body in the frame of the tool."""
    return rotate(tool[1], minus(body[0], tool[0]), inverse=True)


class Moment:
    """What is seen at one time."""

    def __init__(self, time, poses, contacts):
        self.time, self.poses, self.contacts = time, poses, contacts
        self.tool, self.closed, self.opening = None, False, None

    def touching(self, between):
        return [c for c in self.contacts if c["between"] == between and norm(c["force"]) > 0.0]

    def at_tool(self, contact):
        return rotate(self.tool[1], minus(contact["position"], self.tool[0]), inverse=True)

    def sides(self):
        """Force on parts on each side of the hand's middle plane, near the fingertips."""
        sums = [0.0, 0.0]
        for contact in self.touching("robot and object"):
            at = self.at_tool(contact)
            if at[2] > -PALM_M:
                sums[at[1] > 0.0] += norm(contact["force"])
        return sums

    def hardest(self):
        """The largest force of one finger, of the palm, or on the surroundings."""
        palm = [c for c in self.touching("robot and object") if self.at_tool(c)[2] <= -PALM_M]
        return max(*self.sides(), *(sum(norm(c["force"]) for c in some) for some in (palm, self.touching("robot and surroundings"))))

    def grasps(self):
        """Whether both fingers press."""
        return self.closed and min(self.sides()) > 0.2 * GRIP_N


def seconds(stamp):
    return stamp["sec"] + 1e-9 * stamp["nsec"]


def read(path):
    """The moments of an episode and the parameters of its scenario."""
    moments, contacts, samples, commands, parameters = [], {}, [], [], {}
    with open(path, "rb") as file:
        reader = make_reader(file)
        for metadata in reader.iter_metadata():
            parameters.update({k.split(".", 1)[1]: v for k, v in metadata.metadata.items() if k.startswith("parameter.")})
        topics = ["/tf", "/contacts", "/observation", "/command"]
        for _, channel, message in reader.iter_messages(topics=topics):
            data = json.loads(message.data)
            if channel.topic == "/tf":
                poses = {}
                for one in data["transforms"]:
                    p, r = one["translation"], one["rotation"]
                    poses[one["child_frame_id"]] = ([p["x"], p["y"], p["z"]], [r["w"], r["x"], r["y"], r["z"]])
                moments.append(Moment(message.log_time * 1e-9, poses, []))
            elif channel.topic == "/contacts":
                vector = lambda v: [v["x"], v["y"], v["z"]]
                contacts[message.log_time] = [
                    {"between": c["between"], "position": vector(c["position"]), "force": vector(c["force_n"])}
                    for c in data["contacts"]
                ]
            elif channel.topic == "/observation":
                samples.append((seconds(data["timestamp"]), data))
            else:
                commands.append((seconds(data["timestamp"]), data.get("gripper", 0.0)))
    at = 0
    for moment in moments:
        moment.contacts = contacts.get(round(moment.time * 1e9), [])
        while at + 1 < len(samples) and samples[at + 1][0] <= moment.time - 1e-9:
            at += 1
        if moment is moments[0]:
            # The observed pose is that of the last control period, so the tool is followed by the link that carries the hand.
            pose = samples[0][1]["tool_pose"]
            wrist = moment.poses[WRIST]
            offset, turn = inside(wrist, (pose[:3], None)), product(inverse(wrist[1]), pose[3:])
        wrist = moment.poses[WRIST]
        moment.tool = ([a + b for a, b in zip(wrist[0], rotate(wrist[1], offset))], product(wrist[1], turn))
        moment.closed = commands[at][1] > 0.5
        moment.opening = (samples[at][1].get("gripper_opening") or [None])[0]
    return moments, parameters


def hit(moments):
    """The mode of a contact that ends an episode at once."""
    for moment in moments[-3:]:
        if moment.touching("robot and surroundings"):
            return "collision"
    for moment in moments[-3:]:
        if moment.hardest() > LIMIT_N + (GRIP_N if moment.closed or min(moment.sides()) > 1.0 else 0.0):
            return "struck"
    return None


def pressed(moments):
    """Whether the robot pressed for the duration of a jam."""
    since = None
    for moment in moments:
        if moment.hardest() > JAM_N + (GRIP_N if moment.closed else 0.0):
            since = moment.time if since is None else since
            if moment.time - since >= 0.5 * JAM_S:
                return True
        else:
            since = None
    return False


def grasps(moments):
    """Intervals in which the gripper is told to close: first and last moment, and the first one with a grasp."""
    spans, start = [], None
    for i, moment in enumerate(moments):
        if moment.closed and start is None:
            start = i
        if start is not None and (not moment.closed or i + 1 == len(moments)):
            end = i if not moment.closed else i + 1
            # Both fingers press for about a tenth of a second.
            held = next((k for k in range(start, end - 2) if all(m.grasps() for m in moments[k : k + 3])), None)
            spans.append((start, end, held))
            start = None
    return spans


def pick_place(moments, _):
    mode = hit(moments)
    if mode:
        return mode
    spans = grasps(moments)
    rest = moments[0].poses["object"][0][2]
    if spans:
        start, end, held = spans[0]
        if held is None:
            return "grasp_miss"
        last = end >= len(moments)
        if last and not moments[-1].touching("robot and object"):
            return "grip_loss"
        if not last:
            if moments[end].poses["object"][0][2] - rest > 0.05:
                return "grip_loss"
            moved = norm(minus(moments[-1].poses["object"][0], moments[-4].poses["object"][0]))
            if not moments[-1].touching("robot and object") and moved < 1e-3:
                return "misplaced"
    return "jam" if pressed(moments) else "timeout"


def tilt(pose):
    return math.acos(max(-1.0, min(1.0, rotate(pose[1], [0.0, 0.0, 1.0])[2])))


def stacking(moments, parameters):
    mode = hit(moments)
    if mode:
        return mode
    size = float(parameters.get("size_m", 0.05))
    bodies = ["object"] + sorted(name for name in moments[0].poses if name in ("b", "c", "part_b", "part_c"))
    letters = parameters.get("order", "abc")
    order = [bodies["abc".index(letter)] for letter in letters]
    spans = grasps(moments)
    done = 1
    for start, end, held in spans:
        last = end >= len(moments)
        if held is None:
            return "missed" if last else "timeout"
        near = min(bodies, key=lambda name: norm(minus(moments[held].poses[name][0], moments[held].tool[0])))
        placed = [order[level] for level in range(done) if order[level] != near]
        end_of = moments[min(end, len(moments) - 1)]
        if any(tilt(end_of.poses[name]) > 0.26 for name in placed):
            return "toppled"
        if last:
            return "dropped" if not moments[-1].touching("robot and object") else ("jam" if pressed(moments) else "timeout")
        below = order[done - 1]
        off = minus(end_of.poses[near][0], end_of.poses[below][0])
        over = math.hypot(off[0], off[1]) < 1.1 * size
        height = end_of.poses[near][0][2] - ((done + 0.5) * size if over else 0.5 * size)
        following = moments[end:spans[spans.index((start, end, held)) + 1][0]] if (start, end, held) != spans[-1] else moments[end:]
        final = following[-1].poses
        stands = abs(final[near][2 - 2][2] - (done + 0.5) * size) < 0.25 * size and tilt(final[near]) < 0.26
        fallen = any(
            tilt(final[name]) > 0.26 or abs(final[name][0][2] - (level + 0.5) * size) > 0.25 * size
            for level, name in enumerate(order[:done])
        )
        if (start, end, held) == spans[-1]:
            if height > 0.03:
                return "dropped"
            if fallen or (over and not stands):
                return "toppled"
            if not over or stands:
                final_off = minus(final[near][0], final[below][0])
                overhang = float(parameters.get("overhang", 0.0)) * size
                away = math.hypot(final_off[0] - overhang, final_off[1])
                if not stands or away > 0.0095:
                    return "misplaced"
        done += 1
    return "jam" if pressed(moments) else "timeout"


def insertion(moments, parameters):
    mode = hit(moments)
    spans = grasps(moments)
    if mode == "struck":
        return mode
    if not spans:
        return mode or "timeout"
    start, end, held = spans[0]
    if held is None:
        return mode or "missed"
    # The grasp is at rest some moments after the first force.
    steady = next((k for k in range(held, end) if moments[k].time - moments[held].time >= 0.1), held)
    first = inside(moments[steady].tool, moments[steady].poses["object"])
    slip = max(
        (norm(minus(inside(m.tool, m.poses["object"]), first)) for m in moments[steady:end] if m.touching("robot and object")),
        default=0.0,
    )
    # A hand that comes down on the peg may touch it again at the end.
    if moments[-1].closed and sum(not m.touching("robot and object") for m in moments[-4:]) >= 2:
        return "dropped"
    if mode == "collision":
        return "slipped" if slip > 0.005 else mode
    walls = [pose[0] for name, pose in moments[0].poses.items() if name.startswith("block")]
    hole = [sum(wall[i] for wall in walls) / max(1, len(walls)) for i in range(2)]
    depth = lambda m: 0.045 - m.poses["object"][0][2]
    over = lambda m: math.hypot(m.poses["object"][0][0] - hole[0], m.poses["object"][0][1] - hole[1]) < 0.008
    final = moments[-1]
    width = float(parameters.get("width_m", 0.03))
    friction = float(parameters.get("friction", 0.3))
    in_hole = over(final) and depth(final) > 5e-4
    stuck = "wedge" if depth(final) <= friction * width else "jam"
    if end >= len(moments):
        recent = [m for m in moments if m.time >= final.time - 2.0]
        crush = [m for m in moments if m.time >= final.time - 0.4]
        force = lambda m: abs(sum(c["force"][2] for c in m.touching("object and surroundings")))
        if all(force(m) > 75.0 for m in crush):
            return "jam"
        if in_hole and depth(final) - depth(recent[0]) < 0.004 and final.time < 39.9:
            return stuck
        return "slipped" if slip > 0.005 else "timeout"
    if in_hole:
        return stuck
    return "slipped" if slip > 0.005 else "missed"


CLASSIFIERS = {"pick_place": pick_place, "stacking": stacking, "insertion": insertion}


def failures(robogate, work, task, count, episodes):
    """Index and label of failures of a campaign, which is run unless WORK has it."""
    run = work / task
    if not (run / "dictionary.parquet").exists():
        command = [robogate, "--quiet", "run", "--task", task, *RUNS[task], "-n", str(episodes), "--seed", "4401", "--out", str(run)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    rows = work / f"{task}.csv"
    rows.unlink(missing_ok=True)
    subprocess.run([robogate, "--quiet", "export", str(run), str(rows)], check=True, stdout=subprocess.DEVNULL)
    labels = [(int(row["index"]), row["outcome"]) for row in csv.DictReader(rows.open(newline=""))]
    return [(i, label) for i, label in labels if label not in ("success", "invalid")][:count]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("robogate")
    parser.add_argument("work", type=pathlib.Path)
    parser.add_argument("--failures", type=int, default=300)
    parser.add_argument("--episodes", type=int, default=600, help="of each campaign")
    parser.add_argument("--tasks", default=",".join(RUNS))
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    for task in arguments.tasks.split(","):
        chosen = failures(arguments.robogate, arguments.work, task, arguments.failures, arguments.episodes)
        pairs = collections.Counter()
        for index, label in chosen:
            file = arguments.work / f"{task}-{index}.mcap"
            if not file.exists():
                command = [arguments.robogate, "--quiet", "replay", str(arguments.work / task), str(index)]
                subprocess.run([*command, "--mcap", str(file), "--size", "16"], check=True, stdout=subprocess.DEVNULL)
            moments, parameters = read(file)
            found = CLASSIFIERS[task](moments, parameters)
            pairs[(label, found)] += 1
            if found != label:
                print(f"{task} {index}: label {label}, classifier {found}", flush=True)
        same = sum(count for (label, found), count in pairs.items() if label == found)
        print(f"{task}: {same} of {len(chosen)} agree ({100 * same / max(1, len(chosen)):.1f} %)")
        for (label, found), count in sorted(pairs.items()):
            print(f"    {label} -> {found}: {count}")


if __name__ == "__main__":
    main()
