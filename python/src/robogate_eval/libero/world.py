"""LIBERO with Gymnasium's interface: one suite or one task of it, with the benchmark's initial states."""

from __future__ import annotations

import numpy as np

from ..environments.robosuite_world import RobosuiteWorld
from ..serving.model import Model
from . import bddl, initial_states, installation
from .suites import SEED, Suite, wording

VECTORS = {"eef_pos": 3, "eef_axis_angle": 3, "gripper_qpos": 2, "joint_pos": 7}
# Objects that are held touch both fingers.
FINGERS = (("gripper0_leftfinger", "gripper0_finger_joint1_tip"), ("gripper0_rightfinger", "gripper0_finger_joint2_tip"))
# Fields of the model that knobs change.
FIELDS = ("body_pos", "body_quat", "body_mass", "body_inertia", "cam_pos", "cam_quat", "light_diffuse", "mat_rgba", "actuator_gainprm")


class World(RobosuiteWorld):
    """A suite, or one task of it.

    Attributes that start with `wanted_` choose what the next reset loads; None lets the seed choose.
    """

    def __init__(self, suite: Suite, task: int | None = None):
        from gymnasium import spaces

        self.suite = suite
        self.names = installation.task_order()[self.suite.folder]
        self.only = task
        self.wanted_task = self.wanted_state = None
        self._worlds = {}
        # Edits of the model by knobs, undone before the next reset.
        self.edits: Model | None = None
        self._random = np.random.default_rng(0)
        self.observation_space = spaces.Dict({name: spaces.Box(-np.inf, np.inf, (n,)) for name, n in VECTORS.items()})
        self.action_space = spaces.Box(-1.0, 1.0, (7,))
        # The wording of the instruction: see `knobs.py`.
        self.wording = "file_name"
        self.image_noise = 0.0

    # What is loaded

    @property
    def states(self):
        """The initial states of the loaded task."""
        return self._worlds[self.index][2]

    def reset(self, seed: int = 0):
        """Loads a task and one of its initial states."""
        if self.edits is not None:
            self.edits.restore()
        random = np.random.default_rng(seed)
        self.index = self.only if self.wanted_task is None else self.wanted_task
        if self.index is None:
            self.index = int(random.integers(len(self.names)))
        if self.index not in self._worlds:
            self._worlds[self.index] = self._load(self.names[self.index])
        self._env, self.task, states = self._worlds[self.index]
        self.state_index = int(random.integers(len(states))) if self.wanted_state is None else self.wanted_state
        self.wanted_task = self.wanted_state = None
        self.wording, self.image_noise = "file_name", 0.0
        self._random = np.random.default_rng(seed)
        # LIBERO draws the places of fixtures from NumPy's global generator in each reset, and the initial states do not contain them.
        # So that an episode does not depend on the episodes before it, the generator is seeded here.
        np.random.seed(SEED + self.state_index)
        self._env.reset()
        if len(states[self.state_index]) != 1 + self.model.nq + self.model.nv:
            raise ValueError(f"{self.name}: the initial states do not belong to this version of the task")
        # The solver starts from its last result, so without this the last bits would depend on the episodes before.
        self.data.qacc_warmstart[:] = 0.0
        self._observation = self._env.set_init_state(states[self.state_index])
        self.start = self.data.qpos.copy()
        if self.edits is None:
            self.edits = Model(self)
        self.edits.bind(self)
        self.base = {field: getattr(self.model, field).copy() for field in FIELDS}
        self.base["headlight"] = self.model.vis.headlight.diffuse.copy()
        self.begin()
        return self.observe(), {}

    def _load(self, name):
        wrapper = installation.import_environments()
        place = installation.folder()
        file = place / "bddl_files" / self.suite.folder / f"{name}.bddl"
        states = initial_states.read(place / "init_files" / self.suite.folder / f"{name}.pruned_init")
        np.random.seed(SEED)
        # Without robosuite's renderer: RoboGate renders only what a policy asks for. The model of a task is always the same, so it is
        # not compiled again in each reset.
        env = wrapper.ControlEnv(
            bddl_file_name=str(file), has_renderer=False, has_offscreen_renderer=False, use_camera_obs=False, horizon=10**6,
            ignore_done=True, hard_reset=False,
        )  # fmt: skip
        return env, bddl.read(file), states

    @property
    def name(self) -> str:
        """The name of the loaded task."""
        return self.names[self.index]

    @property
    def instruction(self) -> str:
        """The instruction of this episode, in the chosen wording."""
        text = self.told(self.name)
        return {
            "file_name": text,
            "task_file": self.task.instruction,
            "upper_case": text.upper(),
            "polite": f"please {text[:1].lower()}{text[1:]}",
            "none": "",
        }[self.wording]

    def told(self, name: str) -> str:
        """The instruction of a task: that of LIBERO's benchmark class, which derives it from the name of the file. A variant whose file has
        another text than its original, such as `_lan` and `_task` of LIBERO-PRO, varies the instruction: its text counts."""
        files = installation.folder() / "bddl_files"
        if self.suite.original is not None:
            text, original = (bddl.read(files / folder / f"{name}.bddl").instruction for folder in (self.suite.folder, self.suite.original))
            if text != original:
                return text
        return wording(name)

    # Episodes

    def observe(self):
        """The observation in the present state."""
        env = self._env.env
        # robosuite counts a forced update as a time step, and would from then on sample each observation one step (2 ms) earlier than in
        # LIBERO's own loop.
        sensors = list(env._observables.values())
        phases = [(sensor._time_since_last_sample, sensor._sampled) for sensor in sensors]
        seen = env._get_observations(force_update=True)
        for sensor, phase in zip(sensors, phases):
            sensor._time_since_last_sample, sensor._sampled = phase
        return self._encode(seen)

    def _encode(self, seen):
        from robosuite.utils.transform_utils import quat2axisangle

        return {
            "eef_pos": seen["robot0_eef_pos"],
            "eef_axis_angle": quat2axisangle(np.array(seen["robot0_eef_quat"])),
            "gripper_qpos": seen["robot0_gripper_qpos"],
            "joint_pos": seen["robot0_joint_pos"],
        }

    def step(self, action):
        """Runs an action for one control period."""
        seen, *_ = self._env.step(np.asarray(action, dtype=float))
        return self._encode(seen), 0.0, False, False, self._progress()

    def close(self):
        for env, *_ in self._worlds.values():
            env.close()

    # The goal

    def holds(self, predicate) -> bool:
        """Whether a predicate of the goal holds now, as LIBERO evaluates it."""
        return bool(self._env.env._eval_predicate(list(predicate)))

    def position(self, name):
        """The position of an object, a fixture or a region, by its name in the task file."""
        return np.array(self._env.env.object_states_dict[name].get_geom_state()["pos"])

    @property
    def movable(self):
        """The names of the objects that move."""
        return [name for names in self.task.objects.values() for name in names]

    @property
    def moved(self):
        """The objects that the goal puts somewhere, in order of the goal."""
        return list(dict.fromkeys(part[1] for part in self.task.goal if part[0] in ("in", "on")))

    def address(self, name):
        """Where the position of a movable object starts in the state's positions."""
        return int(self.model.jnt_qposadr[self.model.body(f"{name}_main").jntadr[0]])

    def begin(self):
        self._starts = {name: self.position(name) for name in self.movable}
        self._lifted = 0.0
        self._joints = self._articulated()

    def _articulated(self):
        """The joints that the goal moves, with their present positions."""
        env, out = self._env.env, {}
        for verb, name, *_ in self.task.goal:
            if verb not in ("in", "on"):
                for joint in env.get_object(name).joints:
                    out[joint] = float(self.data.qpos[self.model.joint(joint).qposadr[0]])
        return out

    @property
    def handled(self):
        """The body that the task is about: the first object that the goal moves, or else the part that its joint moves."""
        if self.moved:
            return self.model.body(f"{self.moved[0]}_main").id
        return int(self.model.jnt_bodyid[self.model.joint(next(iter(self._joints))).id])

    @property
    def placed(self):
        """The body whose place is varied: the handled object, or the whole fixture of the handled part."""
        return self.handled if self.moved else self.model.body(f"{self.fixture(self.task.goal[0][1])}_main").id

    def fixture(self, name):
        """The fixture that carries a region, or the fixture of this name."""
        sites = self._env.env.object_sites_dict
        return sites[name].parent_name if name in sites else name

    def renew_robot_goal(self):
        """Tells the robot's controller to stay where the robot is."""
        controller = self._env.robots[0].controller
        controller.update(force=True)
        controller.reset_goal()

    def _held(self, name):
        body = self.model.body(f"{name}_main").id
        touching = set()
        for contact in self.data.contact[: self.data.ncon]:
            bodies = self.model.geom_bodyid[contact.geom1], self.model.geom_bodyid[contact.geom2]
            if body in bodies:
                touching.add(self.model.body(bodies[0] if bodies[1] == body else bodies[1]).name)
        return all(touching & set(finger) for finger in FINGERS)

    def _progress(self):
        """What a step achieved. Functions that score an episode read it."""
        lifts = [self.position(name)[2] - self._starts[name][2] for name in self.moved]
        held = [name for name in self.moved if self._held(name)]
        self._lifted = max([self._lifted, *lifts])
        joints = {name: float(self.data.qpos[self.model.joint(name).qposadr[0]]) for name in self._joints}
        satisfied = [self.holds(part) for part in self.task.goal]
        return {
            "success": all(satisfied),
            "satisfied": float(np.mean(satisfied)),
            "held": bool(held),
            "lifted_m": self._lifted,
            "actuated": max([abs(joints[name] - start) for name, start in self._joints.items()], default=0.0),
            "distance_m": self._distance(),
            "displacement_m": max([self._displacement(name) for name in self.moved], default=0.0),
            "disturbance_m": max([self._displacement(name) for name in self.movable if name not in self.moved], default=0.0),
        }

    def _displacement(self, name):
        return float(np.linalg.norm(self.position(name) - self._starts[name]))

    def _distance(self):
        """The largest horizontal distance of an object from where the goal puts it; None for a goal that moves no object."""
        pairs = [(part[1], part[2]) for part in self.task.goal if part[0] in ("in", "on")]
        away = [np.linalg.norm((self.position(name) - self.position(target))[:2]) for name, target in pairs]
        return float(max(away)) if away else None

    # Pictures

    def render(self, camera: str):
        pixels = super().render(camera)
        if self.image_noise > 0.0:
            noisy = pixels + self._random.normal(0.0, self.image_noise, pixels.shape)
            pixels = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
        return pixels
