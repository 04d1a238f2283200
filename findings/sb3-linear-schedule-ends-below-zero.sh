#!/usr/bin/env bash
# stable-baselines3 2.9.2: with the usual linear schedule the last update of PPO, or all of them, go at a negative learning rate: uphill.
#
# A schedule is a function of what remains of the training, said to fall from 1 to 0, and 'lambda remaining: remaining * 3e-4' is how it is
# commonly written. But PPO and A2C collect whole rollouts, so that training goes on past 'total_timesteps', and what remains is
# 1 - steps / total_timesteps without a bound: 10,000 steps in rollouts of 2,048 make 10,240, and the fifth update goes at -0.024 of the
# first rate. Where the rollouts of all environments together are longer than the training (a trial run, 'learn' in small turns), every update
# goes uphill, and faster than the schedule's own maximum. Neither the schedule, nor the optimizer, whose constructor refuses a rate below 0, says
# a word: the rate is written into it afterwards. 'clip_range' goes through the same, and its bounds then change places. With a whole number
# of rollouts the last update goes at a rate of exactly 0. The LinearSchedule of stable-baselines3 itself stops at its end.
#
# Seen (stable-baselines3 2.9.2, torch 2.13.0, gymnasium 1.4.0, Python 3.11): as above, no warning. This script exits with 0 as long as
# that is so, and with 1 when it changes.
set -euo pipefail

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check torch==2.13.0 numpy==2.4.6 gymnasium==1.4.0 stable-baselines3==2.9.2

"$folder/venv/bin/python" -W error::UserWarning - <<'PYTHON'
import sys

import gymnasium
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule

torch.set_num_threads(1)
RATE = 3e-4


def rates(schedule, total, rollout):
    """Return the rate of every update, relative to the schedule's first, as the optimizer has it."""

    class Watched(PPO):
        def train(self):
            super().train()
            seen.append(self.policy.optimizer.param_groups[0]["lr"] / RATE)

    seen = []
    env = gymnasium.make("CartPole-v1")
    Watched("MlpPolicy", env, learning_rate=schedule, n_steps=rollout, batch_size=64, n_epochs=1, seed=0).learn(total)
    return [round(each, 3) for each in seen]


def falling(remaining):
    return remaining * RATE


found = {
    "10,000 steps in rollouts of 2,048": rates(falling, 10_000, 2048),
    "8,192 steps in rollouts of 2,048": rates(falling, 8_192, 2048),
    "300 steps in a rollout of 2,048": rates(falling, 300, 2048),
    "10,000 steps, its own LinearSchedule": rates(LinearSchedule(RATE, 0.0, 1.0), 10_000, 2048),
}
for what, each in found.items():
    print(f"{what}: {each} of the first rate")
parameter = torch.nn.Parameter(torch.zeros(1))
try:
    torch.optim.Adam([parameter], lr=-0.001)
    refused = False
except ValueError:
    refused = True
print("Adam refuses such a rate:", refused)
expected = [[0.795, 0.59, 0.386, 0.181, -0.024], [0.75, 0.5, 0.25, 0.0], [-5.827], [0.795, 0.59, 0.386, 0.181, 0.0]]
sys.exit(0 if [*found.values()] == expected and refused else 1)
PYTHON
