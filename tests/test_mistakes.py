"""Every mistake on a command line ends in one line on standard error and exit status 2, before
anything is computed or written.
"""

import argparse
import shlex
import sys
from importlib import import_module
from pathlib import Path

import pytest

from agents.recipes import RECIPES
from hpac_gym.command import run
from hpac_gym.model import HPAC
from hpac_gym.policies.policy_file import SHIPPED
from tests.options import refused
from tests.processes import python

POSED = "--object cylinder:0.02,0.05 --pose 0.05,0.005,0.11 --dry-run"
DEPLOYED = POSED.replace("--dry-run", "--port virtual")
EVALUATE = "hpac evaluate --policy random"
TINY = f"{EVALUATE} --env tests.tiny_task:Tiny-v0"
BENCHMARK = "hpac benchmark HPAC-Grasp-v0 --policy"
LEROBOT = "hpac record --format lerobot"
SWEEP = "hpac sweep --port any --servo index_mcp"
TRAIN = "agents.train grasp --out {folder}/run"
RESUME = "agents.train --out {folder}/taken --resume"

MISTAKES = [
    ("hpac nonsense", "error: no command 'nonsense' (see hpac --help)"),
    ("hpac shwo", "error: no command 'shwo', did you mean 'show'? (see hpac --help)"),
    ("hpac --polcy", "(see hpac --help)"),
    (
        "hpac evaluate --policy grasp --polcy grasp",
        "error: unrecognized arguments: --polcy (see hpac evaluate --help)",
    ),
    (
        "hpac evaluate --polcy=grasp --episode 3",
        "error: unrecognized arguments: --polcy=grasp (see hpac evaluate --help)",
    ),
    ("hpac posture list fist", "error: unrecognized arguments: fist (see hpac posture"),
    ("hpac wiggle --port /dev/no-such-port", "/dev/no-such-port"),
    *((f"hpac {name}", "required: --port") for name in ("wiggle", "estop", "clear", "conform")),
    ("hpac virtual --angles a.csv --grasp rod", "--angles has no scene: it goes without --env"),
    ("hpac wiggle --port virtual --angle 3", f"at most {min(HPAC.servo_max):.3f} rad"),
    ("hpac doctor --port ''", "--port '' names no port"),
    ("hpac posture nonsense", "nonsense"),
    ("hpac posture fist --out /tmp/fist.doc", "written as .png, not as '/tmp/fist.doc'"),
    ("hpac posture all --out film.gif", "a picture is written as .png, not as 'film.gif'"),
    ("hpac posture all --out /proc/none/all.png", "cannot write to folder '/proc/none'"),
    ("hpac posture all --port virtual", "--port takes one posture, not 'all'"),
    ("hpac posture list --model /no/such/hand.toml", "/no/such/hand.toml"),
    ("hpac calibrate /no/such/sweep.csv", "sweep.csv"),
    (
        "hpac sweep --port any --servo index_mcp --out out",
        "--port needs what measures the joints: --camera or --angles",
    ),
    ("hpac sweep --port any --record x.csv", "not allowed with argument"),
    # As a record with two points would be, after the sweep.
    (f"{SWEEP} --angles x.csv --points 2", "'2' is not a whole number of at least 3"),
    (
        "hpac sweep --record x.csv --servo index_mcp",
        "--points and --trial are of --port, not of --record",
    ),
    (
        "hpac sweep --record x.csv --trial 0",
        "--points and --trial are of --port, not of --record",
    ),
    (
        f"{SWEEP} --angles x.csv --out {{folder}}/nonsense",
        "row 1 must be '# hpac sweep, format 1'",
    ),
    ("hpac deploy tests.test_mistakes:answering:wordless " + POSED, "(action, state), not ndarray"),
    ("hpac deploy tests.test_mistakes:answering:short " + POSED, "must have shape (..., 6), not"),
    ("hpac deploy grasp " + POSED.removesuffix(" --dry-run"), "--port is missing"),
    ("hpac deploy gentle " + POSED, "HPAC-Gentle-v0 cannot be deployed"),
    ("hpac deploy none.hpac " + POSED, "no policy file 'none.hpac'"),
    (f"hpac deploy grasp {POSED} --object ball", "--object 'ball' is not one of cyl"),
    (f"hpac deploy grasp {POSED} --object box:1,2", "--object 'box:1,2' is not one"),
    (
        "hpac deploy posture " + POSED,
        "HPAC-Posture-v1 cannot be deployed: a hand with a camera can do HPAC-Grasp-v0, ",
    ),
    (
        f"hpac deploy grasp-any {POSED} --grasp rod",
        "HPAC-GraspAny-v1 has no grasps by name, such as 'rod'",
    ),
    (
        f"hpac deploy grasp {POSED} --env HPAC-GraspAny-v1",
        "HPAC-Grasp-v0, not on HPAC-GraspAny-v1",
    ),
    (
        f"hpac deploy grasp {POSED} --set obs=load",
        "HPAC-Grasp-v0 with obs cannot be deployed: ",
    ),
    (
        f"hpac deploy grasp {POSED} --set model=x",
        "HPAC-Grasp-v0 with model cannot be deployed: ",
    ),
    (
        f"hpac deploy grasp {POSED} --set object.mass=0.3",
        "--set 'object.mass=0.3': object is ObjectSpec(shape='cylinder'",
    ),
    (
        f"hpac deploy grasp {POSED} --pose 0.9,0,0",
        "at x = 0.900 m in the hand's frame; HPAC-Grasp-v0",
    ),
    (
        f"hpac deploy grasp-any-wrist {DEPLOYED}",
        "grasp-any-wrist places the wrist (wrist_x, wrist_y, wrist_z, wrist_yaw), and --arm none",
    ),
    (
        f"hpac deploy grasp-type --grasp rod {DEPLOYED}",
        "moves none: take --arm enter or --arm udp:HOST:PORT",
    ),
    (f"hpac deploy grasp {DEPLOYED} --port /dev/none", "/dev/none"),
    (f"hpac deploy grasp {DEPLOYED} --arm strong", "--arm 'strong' is not none, enter or"),
    (f"hpac deploy grasp {DEPLOYED} --arm udp:a:²", "--arm 'udp:a:²' is not none"),
    (f"hpac deploy grasp {DEPLOYED} --arm udp:ä..b:9", "the arm at ä..b:9: encoding of"),
    (f"hpac deploy grasp {DEPLOYED} --log /proc/none/x", "cannot write"),
    ("hpac deploy grasp --hold -1", "'-1' is not a number of seconds"),
    ("hpac deploy grasp --oldest nan", "'nan' is not a number of seconds"),
    # Environments and policies
    ("hpac evaluate", "--policy"),
    ("hpac evaluate --policy {folder}/none.hpac", "no policy file"),
    ("hpac evaluate --policy {folder}/file", "is not a policy file"),
    ("hpac evaluate --policy {long}", "no policy file 'xxx"),
    ("hpac evaluate --policy grasp --object {long}.stl", "no object file 'xxx"),
    (f"{TINY} --episodes 1 --out {{long}}", "xxx': File name too long"),
    (f"{BENCHMARK} random --out {{long}}", "xxx': File name too long"),
    ("hpac tags --calibrate 0 --out {long}", "xxx': File name too long"),
    ("hpac record --out {long}", "xxx': File name too long"),
    ("hpac evaluate --policy /", "'/' is not an exported policy: card.json: No such file"),
    ("hpac evaluate --policy grasp --obs image", "deploy (44,), image (84, 84, 3)"),
    (
        "hpac evaluate --policy gentle --env HPAC-Grasp-v0",
        "was trained on hpac_gym:HPAC-Gentle-v0, not on HPAC-Grasp-v0",
    ),
    ("hpac evaluate --policy os:getcwd", "getcwd does not take the environment"),
    (
        "hpac evaluate --policy tests.test_mistakes:forgetful",
        "(observation, state, episode_start)",
    ),
    ("hpac evaluate --policy scripted --object cylinder:20,50", "0.001 to 0.2 m"),
    ("hpac evaluate --policy scripted --object cylinder:nan,0.1", "cylinder:radius"),
    (f"{EVALUATE} --env Nothing-v3", "no environment 'Nothing-v3'"),
    (f"{EVALUATE} --env nothing_here:Nothing-v3", "no environment 'nothing_here:Nothing-v3'"),
    (f"{EVALUATE} --env :", "no environment ':': "),
    (f"{EVALUATE} --env a:b:c", "no environment 'a:b:c': "),
    *(
        (
            f"{EVALUATE} --episodes 1 --env HPAC-Posture-v1 --set max_episode_steps={steps}",
            f"max_episode_steps = {steps} must be a whole number of at least 1",
        )
        for steps in (0, -1)
    ),
    (
        f"{EVALUATE} --env HPAC-GraspType-v0 --grasp rod --types disk",
        "--grasp 'rod' and --types 'disk' were given: give either",
    ),
    (f"{EVALUATE} --set physics=3", "--set physics: only a program in Python can give it"),
    (
        "hpac evaluate --workers 1 --policy tests.test_mistakes:answering:idle",
        "(action, state), not (None, state)",
    ),
    ("hpac show --set render_mode=human", "--set render_mode: hpac show has its own"),
    (f"{EVALUATE} --episodes 0", "'0' is not a whole number of at least 1"),
    (
        f"{EVALUATE} --seed-start 9223372036854775808",
        "is not a whole number of at least 0 and below 2⁶³",
    ),
    (f"{EVALUATE} --workers none", "'none' is not a whole number of at least 1"),
    (
        f"{EVALUATE} --episodes 1 --workers 1 --engine mujoco --set config.weights.effrt=1",
        "config weights has no field 'effrt'",
    ),
    (f"{EVALUATE} --episodes 1 --workers 1 --set wrist=free", "error: no environment"),
    (f"{TINY} --objects real --types hook", "with objects, types: Tiny"),
    (f"{TINY} --episodes 1 --out /proc/no/results.json", "cannot write to folder"),
    (f"{TINY} --episodes 1 --out {{folder}}/policy", "policy': it is a folder"),
    (
        "hpac evaluate --policy {folder}/file --out {folder}/file",
        "file' exists and has no results: name another file",
    ),
    (f"{TINY} --episodes 1 --out {{folder}}/taken/run.json", "run.json' exists and has no results"),
    (
        "hpac benchmark HPAC-Posture-v0 --policy random --out x",
        "'HPAC-Posture-v0' has no benchmark: known are HPAC-Grasp-v0",
    ),
    (
        f"{BENCHMARK} random --budget 1e5 --out x",
        "contains no {seed}: a trained method needs 5 runs",
    ),
    (
        f"{BENCHMARK} random --training-seeds 9 2000000 --out x",
        "training seeds are 9 to 2000000: they must lie in 0 to 999999, in order",
    ),
    (f"{BENCHMARK} random", "--out must be given, or --check alone"),
    (f"{BENCHMARK} random --check x", "it goes without an environment and --policy"),
    (f"{BENCHMARK} no/such.hpac --out x", "no policy file 'no/such.hpac'"),
    (
        f"{BENCHMARK} no.such:thing --out x",
        "no policy 'no.such:thing': No module named 'no'",
    ),
    (
        f"{BENCHMARK} hpac_gym.policies.baselines:Nobody --out x",
        "has no attribute 'Nobody'",
    ),
    ("hpac benchmark --check no/such.json", "cannot read results file 'no/such.json'"),
    (
        "hpac benchmark --check {folder}/deep.json",
        "deep.json' is not a results file: it contains no JSON",
    ),
    (
        "hpac benchmark --check {folder}/file",
        "file' is not a results file: it contains no JSON",
    ),
    ("hpac grasps -n 0", "'0' is not a whole number of at least 1"),
    (
        "hpac grasps --policy best",
        "no policy file 'best', and not one of random, scripted, gentle",
    ),
    ("hpac grasps --policy {folder}/file", "is not a policy file (.hpac)"),
    ("hpac grasps --policy {folder}/cut.hpac", "is damaged"),
    ("hpac grasps --policy {folder}", "is not an exported policy"),
    ("hpac grasps --policy ./mine.py:load", "no policy './mine.py:load': "),
    ("hpac grasps --grasps rods", "no grasp 'rods'; there are 16, among them rod"),
    ("hpac grasps --grasps rod --variant huge", "has no variant 'huge'"),
    (
        "hpac grasps --episodes 0",
        "'0' is not a whole number of at least 1 (see hpac grasps --help)",
    ),
    ("hpac grasps --workers some", "'some' is not a whole number of at least 1"),
    ("hpac grasps --out {folder}/file/results", "cannot write to folder"),
    ("hpac grasps --out /proc/results", "cannot write to folder '/proc/results'"),
    ("hpac grasps --nonsense", "unrecognized arguments: --nonsense"),
    ("hpac record --seed -1", "'-1' is not a whole number of at least 0"),
    ("hpac record --out .", "'.' exists already"),
    ("hpac record --out x --policy none.hpac", "no policy file 'none.hpac'"),
    ("hpac record --out x --episodes 0", "'0' is not a whole number of at least 1"),
    ("hpac record --out /proc/x/y", "cannot write to folder '/proc/x'"),
    (f"{LEROBOT} --out .", "'.' exists already"),
    (
        f"{LEROBOT} --out x --env HPAC-Posture-v1",
        "observes a Dict: LeRobot's format needs one flat",
    ),
    (
        f"{LEROBOT} --out x",
        "needs Python 3.12 or newer and pip install '.[lerobot]' in a checkout of hpac_gym: ",
    ),
    (
        "hpac show --episodes 1 --record film.doc",
        "--record 'film.doc' must end in .gif or .mp4",
    ),
    ("hpac show --episodes 1 --policy none.hpac", "no policy file 'none.hpac'"),
    ("hpac show --episodes 1 --grasp none", "no grasp 'none'"),
    (
        "hpac show --episodes 1 --env CartPole-v1",
        "environment 'CartPole-v1' acts in Discrete(2): policies need",
    ),
    ("hpac show --episodes 1 --env Ant-v5", "'Ant-v5' has no hand for the page: --record FILE"),
    ("hpac show --episodes 1 --record /proc/none/film.gif", "/proc/none"),
    # The workshop
    ("agents.train grasp", "--out"),
    ("agents.train --out {folder}/run", "no recipe given: it must be one of grasp"),
    ("agents.train grasp-ppo --out {folder}/run", "unknown recipe 'grasp-ppo'"),
    (f"{TRAIN} --episodes 0", "episodes is 0: it must lie in 1…1e+08"),
    (f"{TRAIN} --time-limit soon", "'soon' is not a positive number of minutes"),
    (
        f"{TRAIN} --env Nothing-v3",
        "no environment 'Nothing-v3': there are HPAC-Grasp-v0, HPAC-GraspAny-v1",
    ),
    (f"{TRAIN} --env HPAC-Posture-v1", "a closure cannot follow goals"),
    (f"{TRAIN} --set wing=3", "env is 'HPAC-Grasp-v0', and has no such option"),
    (f"{TRAIN} --set config.gap=3", "config gap = 3 m must be a range"),
    (f"{TRAIN} --engine mujoco --set-ups mujoco/twin", "name one set-up"),
    (f"{TRAIN} --set obs=deploy", "obs is 'deploy': a training of closures has its own"),
    (f"{TRAIN} --set reward=sparse", "reward is 'sparse': a training of closures has"),
    (f"{TRAIN} --set render_mode=human", "render_mode is 'human': a training of closures"),
    (f"{TRAIN} --set max_episode_steps=20", "max_episode_steps is 20: a training of closures"),
    (f"{TRAIN} --gamma 0.9", "unrecognized arguments: --gamma"),
    (
        f"{TRAIN} --begin 5,6 --release 1,2",
        "begin is up to 6 steps, release from 1 on: it must come later",
    ),
    (f"{TRAIN} --trials-of {{folder}}/policy {{folder}}/policy", "it names a run twice"),
    ("agents.train grasp --out {folder}/file/run", "cannot write to folder"),
    ("agents.train grasp --out /proc/run", "cannot write to folder '/proc/run'"),
    ("agents.train grasp --out {folder}/taken", "already holds a run"),
    ("agents.train grasp --out {folder}/policy", "already holds a run"),
    ("agents.train grasp --out {folder}/board", "already holds a run, 'tensorboard': --resume"),
    ("agents.train --out {folder}/run --resume", "no run in"),
    (RESUME, "cannot read the settings of"),
    (f"{RESUME} --dropout 0.2", "only --episodes can change"),
    (f"{RESUME} --set told=false", "only --episodes can change"),
    (
        "agents.race sac --env HPAC-Posture-v1 --out {folder}/race",
        "its observation is not a vector",
    ),
    ("agents.race ppo --env Ant-v5 --out {folder}/race", "no environment 'Ant-v5': there are"),
    ("agents.race sac --set tau2=1 --out {folder}/race", "unknown options tau2: there are"),
    ("agents.race ppo --set tau=0.02 --out {folder}/race", "unknown options tau: there are"),
    ("agents.race ppo --set n_steps=few --out {folder}/race", "ppo refuses its settings: "),
    (
        "agents.race ppo --set n_steps=1 --set num_envs=1 --out {folder}/race",
        "ppo refuses its settings: ",
    ),
    (
        "agents.race ppo --set action_repeat=0 --out {folder}/race",
        "action_repeat is 0, must be a whole number from 1 to 1000",
    ),
    ("agents.race sac --set gamma=7 --out {folder}/race", "gamma is 7, must be a number from 0"),
    ("agents.race ppo --set policy_kwargs=5 --out {folder}/race", "is 5, must have names"),
    ("agents.race sac --set device=cuda --out {folder}/race", "sac refuses its settings: "),
    ("agents.race sac --out {folder}/bent", "already holds a run"),
    ("agents.reproduce race --learner td3", "unknown learner 'td3': known are ppo, sac"),
    (
        "agents.reproduce elsewhere --policy scripted --picture picture.png",
        "--picture needs race or seeds",
    ),
    (
        "agents.reproduce seeds --policy none.hpac --out {folder}/file",
        "file' exists and has no results: name another file",
    ),
    ("agents.curves {folder}", "nothing to show"),
    ("agents.curves {folder}/bent", "is not a learning curve"),
    ("agents.demo --minutes 0", "'0' is not a positive number of minutes"),
    *(
        (f"experiments.agree --set-ups {name}", f"'{name}' must be an engine and a body")
        for name in ("mujoco", "/twin", "mujoco/twin/wet", "mujoco/twin/no-torsion/more")
    ),
    (
        "experiments.conformance --engine pybullet --body light",
        "pybullet with body light is not installed",
    ),
    ("experiments.deployed --real-time=nan", "'nan' is not a whole number of at least 1"),
    ("experiments.gentle join", "nothing to join: no results in"),
    ("experiments.gentle judge", "judge, and it alone, takes policies"),
    (
        "experiments.gentle rows --set-up pybullet/twin",
        "--set-up is 'pybullet/twin': rows run in MuJoCo",
    ),
    *(
        (f"experiments.gentle {words}", "rows and judge alone take --set-up and --untold")
        for words in ("closures --set-up mujoco/twin", "closures --untold", "join --untold")
    ),
    ("experiments.study speed --out out", "invalid choice: 'speed' (choose from"),
    ("tools.blind_search --engine mujoco", "'mujoco': the closures of grasp_closures.csv are"),
    ("tools.blind_search --engine nonsense --blind", "invalid choice: 'nonsense'"),
    (
        "tools.film_strip HPAC-Grasp-v0 --policy random --at 9 --out strip.png",
        "at any of [9.0] s",
    ),
    ("tools.generate --hand none.toml", "hand file none.toml: No such file or directory"),
]


def forgetful(env):
    """A policy whose `predict` takes too little."""
    return argparse.Namespace(predict=lambda observation, state=None: (observation[:6], state))


ANSWERS = {
    "wordless": lambda observation, state: observation[:6],
    "idle": lambda observation, state: (None, state),
    "short": lambda observation, state: (observation[:3], state),
}


def answering(env, name):
    """A policy whose answer is no action with a state, or too short."""
    return argparse.Namespace(predict=lambda seen, state, begins: ANSWERS[name](seen, state))


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("mistakes")
    for name in ("taken", "bent", "policy", "nonsense", "board/tensorboard"):
        (folder / name).mkdir(parents=True)
    (folder / "file").write_text("no policy")
    (folder / "cut.hpac").write_bytes(SHIPPED["grasp"].read_bytes()[:1000])
    (folder / "deep.json").write_text("[" * 100_000)
    (folder / "taken" / "run.json").write_text("{}")
    (folder / "bent" / "progress.csv").write_text("steps\none\n")
    (folder / "policy" / "policy.hpac").touch()
    (folder / "nonsense" / "sweep.csv").write_text("nonsense\n")
    return folder


@pytest.mark.parametrize(("line", "complaint"), MISTAKES, ids=[line for line, _ in MISTAKES])
def test_a_mistake_ends_in_one_line_and_status_2(
    folder, line, complaint, tmp_path, monkeypatch, capsys
):
    """In this process, which has loaded the packages already."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "lerobot", None)  # as where it is not installed
    monkeypatch.setattr("hpac_gym.evaluation.dataset._episode", None)  # no recording
    program, *words = shlex.split(line.format(folder=folder, long="x" * 300))
    monkeypatch.setattr(sys, "argv", [program, *words])
    assert complaint in refused(capsys, lambda: run(import_module(program).main))
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_the_whole_command_says_no_more_than_that_line(folder):
    done = python("-m", "agents.train", "grasp-ppo", "--out", str(folder / "run"))
    assert done.returncode == 2
    assert (
        done.stderr
        == f"error: unknown recipe 'grasp-ppo': known are {', '.join(sorted(RECIPES))}\n"
    )
    assert not (folder / "run").exists()
