"""The loop of the training: the student drives, the teacher labels, the student learns from the latest chunks."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
import torch

from fuzzyarm.envs.observation import JOINTS
from fuzzyarm.envs.physics.parameters import ArmParameters
from fuzzyarm.learned_policy.estimate.policy import SEEN, SEEN_PARTS, LearnedObserverPolicy
from fuzzyarm.learned_policy.estimate.signals import TORQUES
from fuzzyarm.rl_baselines.estimate.courses import NOISE, Courses, draw_courses
from fuzzyarm.rl_baselines.estimate.stability import Loops, eigenvalue_loss
from fuzzyarm.rl_baselines.estimate.student import Student, as_tensor
from fuzzyarm.rl_baselines.estimate.teacher import Teacher

PERIOD = 1e-3
_Z, _C, _FEEDFORWARD, _OWN = SEEN_PARTS


@dataclasses.dataclass
class Settings:
    hidden: int = 32
    modulation: int = 16
    lanes: int = 256
    steps: int = 250
    chunks: int = 120
    updates: int = 10
    window: int = 100
    replay: int = 8
    learning_rate: float = 3e-3
    courses_every: int = 6
    largest: float = 0.99
    stability: float = 3.0
    points: int = 6
    seed: int = 0
    quiet_share: float = 0.5


class Drive:
    """Lanes driven by the student."""

    def __init__(self, arm, courses: Courses, policy, generator):
        self.courses, self.lanes, self.gen = courses, courses.lanes, generator
        self.teacher = Teacher(arm, courses)
        n = self.lanes.count
        keys = generator.integers(0, 2**31, n).tolist()
        split = self.lanes.layout.split
        self.obs = split(self.lanes.reset(keys, None, courses.start))[0].copy()
        self.memory = np.zeros((n, policy.memory_size))
        self.begins = np.ones(n, dtype=bool)
        self.sent = np.zeros((4, n, JOINTS))
        self.limit = np.array(arm.torque_limit)

    def chunk(self, policy, steps):
        n, lanes, c = self.lanes.count, self.lanes, self.courses
        seen = np.empty((steps, n, SEEN))
        label = np.empty((steps, n, JOINTS))
        begins = np.ones((steps, n, 1))
        first = np.empty((steps // 50, n, policy.network.hidden))
        free = np.ones((steps, n, JOINTS))
        errors = 0.0
        lost = 0
        torque = np.empty((n, JOINTS))
        for k in range(steps):
            read = self.obs.copy()
            noise = self.gen.standard_normal((n, 4)) * np.repeat(NOISE, JOINTS)
            read[:, :4] += c.noise[:, None] * noise
            if self.begins.any():
                begins[k, self.begins] = 0.0
                self.memory[self.begins] = 0.0
                self.teacher.begin(np.flatnonzero(self.begins))
            if k % 50 == 0:
                first[k // 50] = self.memory[:, policy.hidden]
            label[k] = self.teacher.torque(self.obs)
            free[k] = np.abs(label[k]) < self.limit
            policy.observe(read, self.memory, torque, seen[k])
            ff = seen[k][:, _FEEDFORWARD]
            label[k] = np.clip(ff + (label[k] - ff) / c.gain[:, None], -self.limit, self.limit)
            applied = np.clip(torque, -self.limit, self.limit)
            self.sent = np.roll(self.sent, 1, axis=0)
            self.sent[0] = applied
            self.sent[1:, self.begins] = applied[self.begins]
            whole = np.floor(c.delay).astype(int)
            rest = (c.delay - whole)[:, None]
            ar = np.arange(n)
            late = (1 - rest) * self.sent[whole, ar] + rest * self.sent[np.minimum(whole + 1, 3), ar]
            late = ff + c.gain[:, None] * (late - ff)
            o, v, s = lanes.layout.split(lanes.step(late))
            self.obs = o.copy()
            ended = (s[8] != 0) | (s[9] != 0)
            errors += float((s[1] ** 2).mean())
            lost += int((s[9] != 0).sum())
            self.begins = ended
            if ended.any():
                which = np.flatnonzero(ended)
                self.obs[which] = lanes.layout.split(lanes.reset(None, None, c.start[which], which))[0]
        label -= seen[:, :, _OWN]
        label /= np.array(TORQUES)
        return (
            dict(
                z=as_tensor(seen[:, :, _Z]),
                c=as_tensor(seen[:, :, _C]),
                h=as_tensor(first),
                begins=as_tensor(begins),
                free=as_tensor(free),
                label=as_tensor(np.clip(label, -1, 1)),
            ),
            1e3 * np.sqrt(errors / steps),
            lost,
        )


def train(settings: Settings, report=print):
    torch.set_num_threads(1)
    arm = ArmParameters()
    gen = np.random.default_rng(settings.seed)
    tgen = torch.Generator().manual_seed(settings.seed)
    student = Student(settings.hidden, settings.modulation, tgen)
    policy = LearnedObserverPolicy(student.network(), arm, PERIOD)
    loops = Loops.of(policy)
    optimiser = torch.optim.Adam(student.parameters(), lr=settings.learning_rate)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimiser, settings.chunks * settings.updates, 1e-5)
    replay: list[dict[str, torch.Tensor]] = []
    drive = None
    t0 = time.process_time()
    for chunk in range(settings.chunks):
        if chunk % settings.courses_every == 0:
            drive = Drive(arm, draw_courses(arm, settings.lanes, PERIOD, gen), policy, gen)
        policy = policy.with_network(student.network())
        tc = time.process_time()
        data, rms, lost = drive.chunk(policy, settings.steps)
        tc = time.process_time() - tc
        replay = [*replay, data][-settings.replay :]
        rows = []
        tu = time.process_time()
        for update in range(settings.updates):
            one = replay[-1] if update % 3 == 0 else replay[int(gen.integers(len(replay)))]
            at = 50 * int(gen.integers((settings.steps - settings.window) // 50 + 1))
            one = {
                key: value[at // 50] if key == "h" else value[at : at + settings.window] for key, value in one.items()
            }
            rho, after = student(one["z"], one["c"], one["h"], one["begins"])
            error = (rho - one["label"]) / 0.03
            loss = ((torch.sqrt(1.0 + error * error) - 1.0) * one["free"]).mean()
            extra, radius = torch.zeros(()), torch.zeros(1)
            if settings.stability > 0:
                which = torch.from_numpy(gen.integers(0, len(loops.base), settings.points))
                zz = torch.zeros(settings.points, one["z"].shape[2], dtype=torch.float64)
                hh = torch.zeros(settings.points, settings.hidden, dtype=torch.float64)
                cc = loops.context[which].clone()
                moving = int(settings.points * (1 - settings.quiet_share))
                k = gen.integers(1, settings.window, moving)
                lane = gen.integers(0, settings.lanes, moving)
                zz[:moving] = one["z"][k, lane].double()
                cc[:moving] = one["c"][k, lane].double()
                hh[:moving] = after[k - 1, lane].detach().double()
                # the posture of a visited point decides on the loop
                c1, s1, c12, s12 = cc[:moving, :4].T
                cosine = (c1 * c12 + s1 * s12).numpy()
                nearest = np.abs(cosine[:, None] - loops.cosine[::8][None]).argmin(axis=1)
                which[:moving] = torch.from_numpy(nearest * 8) + which[:moving] % 8
                extra, radius = eigenvalue_loss(student, loops, which, settings.largest, zz, cc, hh)
            optimiser.zero_grad()
            (loss + settings.stability * extra.float()).backward()
            norm = torch.nn.utils.clip_grad_norm_(student.parameters(), 1.0)
            if torch.isfinite(norm):
                optimiser.step()
            schedule.step()
            rows.append((float(loss.detach()), float(extra.detach()), float(radius.max())))
        tu = time.process_time() - tu
        if chunk % 5 == 4 or chunk < 3:
            m = np.mean(rows, axis=0)
            report(
                f"{chunk} rms {rms:.3f} mm lost {lost} loss {m[0]:.4f} stab {m[1]:.4f} radius {m[2]:.3f} | collect {tc:.2f} learn {tu:.2f} total {time.process_time() - t0:.0f} s",
                flush=True,
            )
    return policy.with_network(student.network())
