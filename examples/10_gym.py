"""Where to scan next as a game: two policies in the Gymnasium environment, and what they reach.

python examples/10_gym.py, with: pip install 'insonify[gymnasium]'
"""

import time

import gymnasium

import insonify.gym  # noqa: F401 - registers the environments
from insonify.planning.rosette import DISTINCT_LOBES


def play(env, policy):
    """One episode; the last info, and steps a second."""
    _, info = env.reset(seed=0)
    env.action_space.seed(0)
    over, steps, since = False, 0, time.perf_counter()
    while not over:
        _, _, terminated, truncated, info = env.step(policy(steps))
        over, steps = terminated or truncated, steps + 1
    return info, steps / (time.perf_counter() - since)


coarse = ["mapping.voxel_m=0.2"]
poses = gymnasium.make("insonify/Tetrapod-v0", settings=coarse, pings=60)
lobes = gymnasium.make("insonify/Tetrapod-v0", settings=coarse, pings=60, moves="lobe")
policies = {
    "random poses": (poses, lambda step: poses.action_space.sample()),
    "random lobes": (lobes, lambda step: lobes.action_space.sample()),
    "rosette": (lobes, lambda step: step % DISTINCT_LOBES),
}
for name, (env, policy) in policies.items():
    info, rate = play(env, policy)
    print(
        f"{name}: solid F1 {info['f1']:.3f} after {info['pings']} pings, "
        f"{info['path_m']:.0f} m, {rate:.1f} steps/s"
    )
