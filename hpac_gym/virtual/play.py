"""``hpac play``: six sliders move a simulated hand in the browser; without port, firmware or policy."""

import argparse
import time
from contextlib import ExitStack, closing, suppress

from hpac_gym.bridge import pulses_from_servo
from hpac_gym.command import add_json, say
from hpac_gym.tasks.task import CONTROL_HZ
from hpac_gym.virtual.body import Body
from hpac_gym.virtual.hand import POSE_HZ
from hpac_gym.virtual.scene import add_scene, env_of, scene

OPPOSED = 1.2
"""Angle of the thumb's CMC at the start, at which the thumb opposes the fingers [rad]."""
ABOUT = (
    "A simulated hand. Each slider is a servo; the other joints follow by their tendons. "
    "Close it on the object, and lift."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `hpac play`."""
    add_scene(parser)
    parser.add_argument("--no-browser", action="store_true", help="print the page's address only")
    add_json(parser)
    parser.set_defaults(run=run)


def run(options: argparse.Namespace) -> int:
    """Move the hand as the sliders say, until Ctrl-C."""
    from hpac_gym.view.page import HandPage, Shown

    with suppress(KeyboardInterrupt), ExitStack() as stack:
        env = stack.enter_context(env_of(options)).unwrapped
        body = Body(env, options.seed or 0, scene(env, options.env, options.seed))
        page = HandPage(body.setup, ABOUT, browser=not options.no_browser)
        stack.enter_context(closing(page))
        if options.json:
            say(True, "", page=page.address)
        page.lift.visible = True
        page.sliders[-1].value = OPPOSED
        began = time.monotonic()
        told = -1
        while True:
            now = time.monotonic() - began
            servo = page.wanted()
            if int(now * CONTROL_HZ) != told:
                told = int(now * CONTROL_HZ)
                body.tell({"time": told / CONTROL_HZ, "offset": [0.0, 0.0, page.lifted()]})
            body.follow(round(1e6 * now), pulses_from_servo(servo))
            state = body.state()
            body.tidy_up(state)
            if page.object_back.is_set():
                page.object_back.clear()
                body.place(body.setup, state.horn[0])
            if page.due():
                page.show(Shown.of_state(state, servo))
            time.sleep(1 / POSE_HZ)
    return 0
