"""The commands that `faults.py` disturbs: every verb that writes files."""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass
class Command:
    """A command that writes. `before` prepares its folder without faults; `{code}` is the code of the next trial of `study`."""

    name: str
    line: str
    before: list[str] = field(default_factory=list)
    # The command that continues the campaign in its folder; it is used once there is a plan.
    resume: str = ""
    # A command whose output says what was written, where the bytes differ each time (keys, clocks). Otherwise bytes are compared.
    shown_by: str = ""
    # What the command acknowledged must survive a power failure after its end.
    durable: bool = False
    # A file beside the result, whose lost records no command makes again.
    beside: str = ""
    # It writes random bytes: the names of its files are compared, and the exit code of `shown_by`.
    random: bool = False
    # It starts other processes that write, whose calls are not logged.
    starts_others: bool = False


RUN = "run --task pendulum -n 24 --seed 3 --design uniform --threads 1 --out r"
OTHER = "run --task pendulum --policy random -n 24 --seed 3 --design uniform --threads 1 --out other"
GATE = "gate --task pendulum --requirements req.toml --threads 1 --out r"
# A campaign whose disk is full at its 40th write.
CUT = "full:40:" + RUN
SHARDS = ["run --task pendulum -n 24 --seed 3 --design uniform --divide 2 --out r", "run --shard 0/2 --out r", "run --shard 1/2 --out r"]
STUDY = "trial plan study --policy a --policy b --blocks 4 --count 12"
START = "trial record study start --code {code} --operator Ada"
STOP = "trial record study stop --code {code}"

COMMANDS = [
    Command("run", RUN, resume="resume r", durable=True),
    Command("run, two stages", "run --task pendulum -n 40 --seed 3 --design two-stage --threads 1 --out r", resume="resume r", durable=True),
    Command("run, signals", RUN + " --record-signals", resume="resume r", durable=True, beside="r/signals.rgs"),
    Command("run --divide", SHARDS[0], durable=True),
    Command("run --shard", SHARDS[1], SHARDS[:1], durable=True),
    Command("merge", "merge r", SHARDS, durable=True),
    Command("resume", "resume r", [CUT], durable=True),
    Command("gate", GATE, resume="resume r", durable=True),
    Command("gate --run", "gate --run r --requirements req.toml --out v --write-baseline b.json", [RUN]),
    Command("report", "report r --out page.html", [RUN]),
    Command("report --markdown", "report r --format md --out page.md", [RUN]),
    Command("view", "view r --out view.html", [RUN]),
    Command("figure", "figure r marginal-effects-torque-limit --svg a.svg --csv a.csv", [RUN]),
    Command("compare", "compare r other --out c.html", [RUN, OTHER]),
    Command("leaderboard", "leaderboard r other --format html --out l.html", [RUN, OTHER]),
    Command("replay", "replay r 3 --mcap episode.mcap", [RUN]),
    Command("transfer", "transfer --sim r --real real.csv --out t.json --html t.html", [RUN]),
    Command("export, CSV", "export r rows.csv", [RUN], durable=True),
    Command("export, JSON lines", "export r rows.jsonl", [RUN], durable=True),
    Command("export, JSON", "export r rows.json", [RUN], durable=True),
    Command("import", "import rows.csv rows.parquet", [RUN, "export r rows.csv"], durable=True),
    Command("evidence", "evidence r e --requirements req.toml", [RUN], durable=True),
    Command("evidence --key", "evidence r e --requirements req.toml --key key", [RUN, "keys new key"], shown_by="verify e --key key.pub"),
    Command("keys new", "keys new key", shown_by="keys id key.pub", random=True),
    Command("monitor reference", "monitor reference r --learn-baseline --out m.json", [RUN]),
    Command("monitor serve", "monitor serve cycles.jsonl --store s.db", shown_by="monitor recipes list s.db", durable=True),
    Command(
        "monitor recipes merge", "monitor recipes merge s.db industrial-68 bracket", ["monitor serve cycles.jsonl --store s.db", "monitor serve bracket.jsonl --store s.db"],
        shown_by="monitor recipes list s.db", durable=True,
    ),
    Command("trial plan", STUDY, shown_by="trial status study", durable=True),
    Command("trial next", "trial next study", [STUDY], shown_by="trial status study", durable=True),
    Command("trial record", START, [STUDY, "trial next study"], shown_by="trial status study", durable=True),
    Command(
        "trial record, result", "trial record study result --code {code} --result success", [STUDY, "trial next study", START, STOP],
        shown_by="trial status study", durable=True,
    ),
    Command("trial unblind", "trial unblind study --early", [STUDY, "trial next study", START, STOP], shown_by="trial status study", durable=True),
    Command("trial report", "trial report study --out answer", [STUDY, "trial unblind study --early"], shown_by="trial status study"),
    Command("init", "init rows.csv --success 80%", [RUN, "export r rows.csv"], starts_others=True),
    Command("tasks init", "tasks init cell"),
    Command("robots init", "child-command robots init arm.urdf"),
    Command("completions", "completions bash --out c"),
    Command("requalify", "requalify arm --engine rapier --pairs 4 --out q.html", ["run -n 6 --seed 3 --design uniform --threads 1 --out arm"]),
    Command("warn train", "warn train r --successes-only --out w.json --threads 1", ["run --task pendulum -n 380 --seed 3 --design uniform --record-signals --out r"]),
    Command("demos", "demos -n 1 --all --size 32 --threads 1 --out d"),
    Command("rank", "rank scripted random --task pendulum --rounds 1 --threads 1 --out r", durable=True),
    Command("fleet", "fleet --task pendulum --units 2 --unit-space unit.toml --requirements req.toml --threads 1 --out r", resume="resume r", durable=True),
    Command("matrix", "matrix sweep.toml --threads 1 --out r", starts_others=True),
    Command("gate --register", GATE + " --register key", ["keys new key"], resume="resume r", shown_by="gate --run r --requirements req.toml"),
]

# Files that the commands read.
FILES = {
    "req.toml": 'name = "req"\nmode = "confidence"\nconfidence = 0.9\n[budget]\nrounds = 4\n[[requirement]]\nmetric = "success"\nat_least = 0.3\n',
    "unit.toml": 'name = "unit"\n[[parameter]]\nname = "angle_bias_rad"\nkind = "continuous"\nlow = -0.02\nhigh = 0.02\n',
    "sweep.toml": (
        'version = 1\nname = "s"\nseed = 7\n[[task]]\nname = "pendulum"\nepisodes = 16\n[[policy]]\nname = "scripted"\n'
        '[[policy]]\nname = "random actions"\npolicy = "random"\n'
    ),
}
FILES["real.csv"] = "success,torque_limit_nm\n" + "".join(f"{i % 3 > 0},{0.4 + 0.04 * i:.2f}\n".lower() for i in range(20))
# Files of the documentation.
EXAMPLES = {"cycles.jsonl": "cycles.jsonl", "arm.urdf": "arm/arm.urdf"}
# Another recipe of the same cell.
OTHERS = {"bracket.jsonl": ("cycles.jsonl", [("industrial-68", "bracket"), ("cell-1/", "cell-1/b")])}
