"""Stable-Baselines3's side of the benchmarks; runs under its own Python, without hiprl.

    python sb3_side.py search MODEL.npz     PPO in a learned ensemble, given as arrays
    python sb3_side.py world SETTINGS.json  PPO in the true environment

Each prints one JSON object on its last line.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecNormalize

MIN_LOG_VAR, MAX_LOG_VAR = -10.0, 1.0
PPO_SETTINGS = (
    "learning_rate",
    "n_steps",
    "batch_size",
    "n_epochs",
    "gamma",
    "gae_lambda",
    "clip_range",
    "ent_coef",
    "vf_coef",
    "max_grad_norm",
)

Forward = Callable[[np.ndarray], np.ndarray]
"""A standardised (s, a) to what the M networks give, (M, 2p)."""


def forwards(model: dict[str, np.ndarray]) -> dict[str, Forward]:
    """Ways to compute the ensemble for one input: they differ in speed only."""
    layers = sum(name.startswith("W") for name in model)
    Ws, bs = [model[f"W{i}"] for i in range(layers)], [model[f"b{i}"] for i in range(layers)]
    columns = [b[:, None, :] for b in bs]
    M = len(Ws[0])
    wide = np.ascontiguousarray(np.concatenate(Ws[0], axis=1))  # all first layers side by side: one product
    wide_b = np.concatenate(bs[0])
    torch_Ws, torch_bs = [torch.as_tensor(W) for W in Ws], [torch.as_tensor(b) for b in columns]

    def stacked(x: np.ndarray) -> np.ndarray:
        h = np.broadcast_to(x, (M, 1, len(x)))
        for W, b in zip(Ws[:-1], columns[:-1], strict=True):
            h = np.maximum(h @ W + b, 0)
        return (h @ Ws[-1] + columns[-1])[:, 0]

    def side_by_side(x: np.ndarray) -> np.ndarray:
        h = np.maximum(x @ wide + wide_b, 0).reshape(M, 1, -1)
        for W, b in zip(Ws[1:-1], columns[1:-1], strict=True):
            h = np.maximum(h @ W + b, 0)
        return (h @ Ws[-1] + columns[-1])[:, 0]

    @torch.inference_mode()
    def by_torch(x: np.ndarray) -> np.ndarray:
        h = torch.from_numpy(x).expand(M, 1, -1)
        for W, b in zip(torch_Ws[:-1], torch_bs[:-1], strict=True):
            h = torch.relu_(torch.baddbmm(b, h, W))
        return torch.baddbmm(torch_bs[-1], h, torch_Ws[-1])[:, 0].numpy()

    return {"numpy, stacked": stacked, "numpy, side by side": side_by_side, "torch": by_torch}


def fastest(choices: dict[str, Forward], x: np.ndarray) -> str:
    """The name of the way that is fastest here."""

    def seconds(forward: Forward) -> float:
        for _ in range(100):
            forward(x)
        began = time.process_time()
        for _ in range(1000):
            forward(x)
        return time.process_time() - began

    return min(choices, key=lambda name: seconds(choices[name]))


class Imagined(gym.Env):
    """f̃ and r̂ as an environment: an action is q entries of a and p of η, all in [-1, 1]."""

    def __init__(self, model: dict[str, np.ndarray], settings: dict[str, Any]):
        self.m, self.task, self.H = model, settings["task"], settings["H"]
        self.p = model["low"].size
        size = model["check_u"].shape[1]
        self.q = size - self.p
        self.observation_space = gym.spaces.Box(-np.inf, np.inf, (self.p,), np.float32)
        self.action_space = gym.spaces.Box(-1.0, 1.0, (size,), np.float32)
        choices = forwards(model)
        self.forward_name = fastest(choices, np.zeros(self.p + self.q, np.float32))
        self.forward = choices[self.forward_name]
        self.rng = np.random.default_rng(settings["seed"])
        reward_layers = sum(name.startswith("rW") for name in model)
        self.reward_layers = [(model[f"rW{i}"], model[f"rb{i}"]) for i in range(reward_layers)]

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[np.ndarray, dict]:
        self.t = 0
        self.s = self.m["first"][self.rng.integers(len(self.m["first"]))]
        return self.s, {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        draw = self.rng.standard_normal(self.p, dtype=np.float32)
        s_next, r = self.imagine(self.s, action, draw)
        self.s, self.t = s_next, self.t + 1
        return s_next, r, self.ended(s_next), self.t >= self.H, {}

    def imagine(self, s: np.ndarray, u: np.ndarray, draw: np.ndarray) -> tuple[np.ndarray, float]:
        """The next state by eq. (5), with noise, and the reward."""
        m, p = self.m, self.p
        sa = np.concatenate([s, u[: self.q]])
        out = self.forward((sa - m["in_mean"]) / m["in_std"])
        mean = out[:, :p]
        e = np.exp(np.minimum(out[:, p:], 40.0))
        var = np.exp(MIN_LOG_VAR) + e / (1 + e * np.exp(-MAX_LOG_VAR))
        centre = mean.mean(0)
        sigma = m["step_std"] * np.sqrt(((mean - centre) ** 2).sum(0) / (len(mean) - 1))
        noise = m["step_std"] * np.sqrt(var.mean(0))
        mu = s + m["step_mean"] + m["step_std"] * centre
        s_next = np.clip(mu + m["beta"] * sigma * u[self.q :] + noise * draw, m["low"], m["high"])
        h = (sa - m["r_mean"]) / m["r_std"]
        for W, b in self.reward_layers[:-1]:
            h = np.maximum(h @ W + b, 0)
        W, b = self.reward_layers[-1]
        return s_next.astype(np.float32), float((h @ W)[0] + b[0])

    def ended(self, s: np.ndarray) -> bool:
        """The rule of the task."""
        return self.task.startswith("InvertedPendulum") and not (np.isfinite(s).all() and abs(s[1]) <= 0.2)

    def disagreement(self) -> float:
        """Greatest difference from the steps that the other side computed, in typical steps and rewards."""
        m, still = self.m, np.zeros(self.p, np.float32)
        worst = 0.0
        for s, u, s_next, r in zip(m["check_s"], m["check_u"], m["check_next"], m["check_r"], strict=True):
            ours, our_r = self.imagine(s, u, still)
            worst = max(worst, float(np.max(np.abs(ours - s_next) / m["step_std"])), abs(our_r - r) / (1 + abs(r)))
        return worst


class Clock(BaseCallback):
    """Takes the time from the first step on."""

    def _on_training_start(self) -> None:
        self.cpu, self.wall = time.process_time(), time.perf_counter()

    def _on_step(self) -> bool:
        return True

    def _on_training_end(self) -> None:
        self.cpu, self.wall = time.process_time() - self.cpu, time.perf_counter() - self.wall


def search(path: str) -> dict[str, Any]:
    """PPO in the learned ensemble."""
    with np.load(path) as file:
        model = {name: file[name] for name in file.files}
    settings = json.loads(str(model.pop("settings")))
    env = Imagined(model, settings)
    ppo = PPO("MlpPolicy", env, seed=settings["seed"], device="cpu", **chosen(settings["ppo"]))
    clock = Clock()
    ppo.learn(settings["steps"], callback=clock)
    return {
        "steps": ppo.num_timesteps,
        "cpu": clock.cpu,
        "wall": clock.wall,
        "forward": env.forward_name,
        "disagreement": env.disagreement(),
    }


def world(path: str) -> dict[str, Any]:
    """PPO in the true environment, and what it reaches on the way."""
    with open(path) as file:
        settings = json.load(file)
    steps, seed, n_envs = settings["steps"], settings["seed"], settings.get("n_envs", 1)
    env = make_vec_env(settings["env"], n_envs, seed=seed)
    normalized = settings.get("normalize", False)
    if normalized:
        env = VecNormalize(env, gamma=settings["ppo"]["gamma"])
    ppo = PPO("MlpPolicy", env, seed=seed, device="cpu", **chosen(settings["ppo"]), **policy(settings))
    curve, began = [], time.perf_counter()
    looks = settings.get("looks", 10)
    for look in range(1, looks + 1):
        ppo.learn(steps * look // looks - ppo.num_timesteps, reset_num_timesteps=False)
        test = make_vec_env(settings["env"], 1, seed=10_000 + seed)
        if normalized:
            test = VecNormalize(test, training=False, norm_reward=False)
            test.obs_rms = env.obs_rms
        last = look == looks
        mean, std = evaluate_policy(ppo, test, n_eval_episodes=settings["eval_episodes"] if last else 3)
        curve.append([ppo.num_timesteps, float(mean)])
    return {
        "env_steps": ppo.num_timesteps,
        "return_mean": float(mean),
        "return_std": float(std),
        "wall_seconds": time.perf_counter() - began,
        "curve": curve,
    }


def chosen(settings: dict[str, Any]) -> dict[str, Any]:
    """Of the settings those that PPO knows."""
    return {name: settings[name] for name in PPO_SETTINGS if name in settings}


def policy(settings: dict[str, Any]) -> dict[str, Any]:
    """How the policy is built, where that is not Stable-Baselines3's default."""
    wanted = dict(settings.get("policy", {}))
    if not wanted:
        return {}
    if "activation" in wanted:
        wanted["activation_fn"] = {"relu": torch.nn.ReLU, "tanh": torch.nn.Tanh}[wanted.pop("activation")]
    return {"policy_kwargs": wanted}


if __name__ == "__main__":
    torch.set_num_threads(1)
    print(json.dumps({"search": search, "world": world}[sys.argv[1]](sys.argv[2])))
