"""Train the attention-LSTM: clips in; network, model card and log out. Killed, it goes on."""

from __future__ import annotations

import csv
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import nn

from e3pose.base.atomic import atomic_file, write_file
from e3pose.base.errors import InputError
from e3pose_lab.train.card import model_card
from e3pose_lab.train.experts import start_experts
from e3pose_lab.train.export import export, halved
from e3pose_lab.train.network import AttentionLstm, NetworkSettings
from e3pose_lab.train.validation import Exam, error_curves, examine, make_exams, score
from e3pose_lab.train.windows import Clip, Corruption, Sampler, Variety, Windows
from e3pose_lab.workers import Workers

CHECKPOINT = "checkpoint.pt"
WARMUP = 0.03  # share of the training in which the learning rate rises
LAST_RATE = 0.02  # of the largest learning rate, at the end
ERROR_WEIGHT = 0.1  # of learning how far off a prediction is
FLOOR_M = 0.0003  # errors below this are as good as none
LATE_SHARE = 0.005  # of the usual error at the last lead, which tells how hard a window is
AVERAGE_STEPS = 1000.0  # weights are averaged over about as many of the latest steps


@dataclass(frozen=True, slots=True)
class TrainSettings:
    """How to train.

    Attributes:
        network: sizes.
        num_leads: slots that the decoder is trained to look ahead.
        steps: batches at most.
        minutes: time at most; the learning rate falls as either runs out.
        batch: windows a batch.
        learning_rate: the largest.
        weight_decay: of matrices.
        validate_every: steps.
        patience: validations without progress before training stops early.
        seed: of weights and windows.
        expert_windows: per kind of history, from which experts are found before training.
        started_from: the weights that training goes on from, if any, for the card.
        loss: `relative` to the best simple predictor, or `squared`, eq. (6) of the paper.
        variety: what windows are made of recorded motion.
    """

    network: NetworkSettings = field(default_factory=NetworkSettings)
    num_leads: int = 15
    steps: int = 15_000
    minutes: float = math.inf
    batch: int = 128
    learning_rate: float = 2e-3
    weight_decay: float = 0.1
    validate_every: int = 500
    patience: int = 20
    seed: int = 0
    expert_windows: int = 8_000
    started_from: str = "nothing"
    loss: Literal["relative", "squared"] = "relative"
    variety: Variety = "bodies"


class Training:
    """The state of a training run: network, optimiser, averages and what was best."""

    def __init__(self, settings: TrainSettings) -> None:
        torch.manual_seed(settings.seed)
        self.settings = settings
        self.network = AttentionLstm(settings.network)
        learned = [p for p in self.network.parameters() if p.requires_grad]
        matrices = [p for p in learned if p.dim() > 1]
        others = [p for p in learned if p.dim() <= 1]
        self.optimizer = torch.optim.AdamW(
            [
                {"params": matrices, "weight_decay": settings.weight_decay},
                {"params": others, "weight_decay": 0.0},
            ],
            lr=settings.learning_rate,
        )
        self._begin_here()
        self.best_score, self.stale = math.inf, 0
        self.step, self.elapsed_s = 0, 0.0

    def start(self, sampler: Sampler) -> None:
        """Let the experts of an untrained network be what regressions find."""
        rng = np.random.default_rng([self.settings.seed, 1])
        if self.settings.network.experts:
            start_experts(self.network, sampler, rng, self.settings.expert_windows)
        self._begin_here()

    def take_up(self, network: AttentionLstm) -> None:
        """Go on from a network that was trained before, experts and all."""
        self.network.load_state_dict(network.state_dict())
        self._begin_here()

    def _begin_here(self) -> None:
        self.average = {k: v.clone() for k, v in self.network.state_dict().items()}
        self.best = {k: v.clone() for k, v in self.average.items()}  # averages change in place

    @property
    def done(self) -> float:
        """Share of the training that is done, [0, 1]."""
        by_time = self.elapsed_s / 60 / self.settings.minutes
        return min(1.0, max(self.step / self.settings.steps, by_time))

    def advance(self, windows: Windows) -> float:
        """Learn from one batch; return its loss."""
        rate = min(1.0, (self.done + 1e-4) / WARMUP)
        rate *= LAST_RATE + (1 - LAST_RATE) * 0.5 * (1 + math.cos(math.pi * self.done))
        for group in self.optimizer.param_groups:
            group["lr"] = self.settings.learning_rate * rate
        self.network.train()
        loss = batch_loss(self.network, windows, self.settings.loss)
        self.optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(self.network.parameters(), 1.0)
        self.optimizer.step()
        self.step += 1
        share = max(1 / AVERAGE_STEPS, 9 / (10 + self.step))
        with torch.no_grad():
            for name, value in self.network.state_dict().items():
                self.average[name].lerp_(value, share)
        return float(loss.detach())

    def averaged(self) -> AttentionLstm:
        """Return a network of the averaged weights."""
        network = AttentionLstm(self.settings.network)
        network.load_state_dict(self.average)
        return network

    def save(self, path: Path) -> None:
        """Write everything that is needed to go on."""
        content = {
            "settings": repr(self.settings),
            "network": self.network.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "average": self.average,
            "best": self.best,
            "numbers": [self.best_score, self.stale, self.step, self.elapsed_s],
        }
        with atomic_file(path) as temporary:
            torch.save(content, temporary)

    def load(self, path: Path) -> None:
        """Go on where a checkpoint ends; raise `InputError` if it is damaged or of another run."""
        try:
            content: dict[str, Any] = torch.load(path, weights_only=True, map_location="cpu")
            same = content["settings"] == repr(self.settings)
        except Exception as error:  # torch raises many kinds for damaged files
            raise InputError(f"{path}: found no readable checkpoint of a training") from error
        if not same:
            raise InputError(f"{path}: settings: found other ones, expected {self.settings}")
        self.network.load_state_dict(content["network"])
        self.optimizer.load_state_dict(content["optimizer"])
        self.average, self.best = content["average"], content["best"]
        self.best_score, stale, step, self.elapsed_s = content["numbers"]
        self.stale, self.step = int(stale), int(step)


def batch_loss(network: AttentionLstm, windows: Windows, kind: str = "relative") -> torch.Tensor:
    """Return the loss of a batch: `relative`, or the `squared` error, eq. (6) of the paper.

    The relative one is the mean error relative to that of the best simple predictor, so that a
    millimetre counts as much in slow motion as a centimetre in fast. The expected error, where the
    network states one, is learned beside it, from the errors as they are.
    """
    normal = windows.normal
    places, log_error = network(
        torch.from_numpy(normal.features), torch.from_numpy(normal.context), len(windows.future_m)
    )
    future = torch.from_numpy(windows.future_m.astype(np.float32))
    seen = torch.from_numpy(normal.seen.astype(np.float32))
    apart = places - future
    loss: torch.Tensor = (apart.square().sum(dim=-1) * seen).sum(dim=0).mean()
    error = apart.norm(dim=-1)
    if kind == "relative":
        usual = torch.from_numpy(windows.usual_m.astype(np.float32))
        weight = 1 / (usual + FLOOR_M + LATE_SHARE * usual[-1:])
        loss = (error * seen * weight.unsqueeze(-1)).mean()
    if not network.settings.moves:
        return loss
    claim = log_error + error.detach() / log_error.exp()
    return loss + ERROR_WEIGHT * (claim * seen).mean()


def train(
    training_clips: Sequence[Clip],
    validation_groups: Sequence[tuple[str, Sequence[Clip]]],
    out: Path,
    settings: TrainSettings,
    progress: Callable[[float, str], None] = lambda share, text: None,
    workers: Workers | None = None,
    start: AttentionLstm | None = None,
) -> Path:
    """Train, and write weights, model card, log and checkpoints into the folder `out`.

    Args:
        training_clips: motion to learn from.
        validation_groups: named groups of clips that are never learned from.
        out: a folder; if it holds the checkpoint of a killed run of the same settings, that run
            goes on.
        settings: how.
        progress: called with the share that is done and one line about it.
        workers: who draws the windows; the result does not depend on them.
        start: a trained network of the same sizes to go on from.

    Returns:
        The file of the weights.
    """
    slots = settings.network.history_slots
    sampler = Sampler(training_clips, slots, settings.num_leads, variety=settings.variety)
    exams = make_exams(validation_groups, slots, settings.num_leads)
    out.mkdir(parents=True, exist_ok=True)
    run = Training(settings)
    if (out / CHECKPOINT).exists():
        run.load(out / CHECKPOINT)
    elif start is not None:
        run.take_up(start)
        run.best_score = score(examine(start, exams))  # what comes must be better to be kept
    else:
        known = [clip for clip in training_clips if not clip.replayed]  # experts are by noise
        run.start(Sampler(known, slots, settings.num_leads))
    board = _board(out / "tensorboard")
    losses: list[float] = []
    steps = range(run.step, settings.steps)
    batches = (workers or Workers()).run(_draw, (sampler, settings), steps)
    while run.done < 1 and run.stale <= settings.patience:
        began = time.monotonic()
        torch.manual_seed(settings.seed + run.step)
        losses.append(run.advance(next(batches)))
        run.elapsed_s += time.monotonic() - began
        if run.step % settings.validate_every == 0 or run.done >= 1:
            row = _validate(run, exams, float(np.mean(losses)))
            losses.clear()
            _append(out / "log.csv", row)
            for name, value in row.items():
                if board is not None:
                    board.add_scalar(name, value, run.step)
            run.save(out / CHECKPOINT)
        progress(run.done, f"score {run.best_score:.3f}")
    spared = [clip for _, clips in validation_groups for clip in clips]
    return _finish(run, exams, training_clips, spared, out)


def _draw(source: tuple[Sampler, TrainSettings], step: int) -> Windows:
    """Return the windows of a step, whoever draws them."""
    sampler, settings = source
    rng = np.random.default_rng([settings.seed, step])
    return sampler.draw(rng, settings.batch, Corruption())


def _validate(run: Training, exams: Sequence[Exam], loss: float) -> dict[str, float]:
    marks = examine(run.averaged(), exams)
    now = score(marks)
    if now < run.best_score:
        run.best_score, run.stale = now, 0
        run.best = {name: value.clone() for name, value in run.average.items()}
    else:
        run.stale += 1
    row = {"step": float(run.step), "seconds": run.elapsed_s, "loss": loss, "score": now}
    for mark in marks:
        for lead in (1, 3, 5, 10, 15):
            if lead <= len(mark.ratio):
                row[f"{mark.name}, lead {lead}"] = float(mark.ratio[lead - 1])
    return row


def _finish(
    run: Training,
    exams: Sequence[Exam],
    training: Sequence[Clip],
    validation: Sequence[Clip],
    out: Path,
) -> Path:
    """Write the best network and its card."""
    network = AttentionLstm(run.settings.network)
    network.load_state_dict(run.best)
    halved(network)
    marks = examine(network, exams)
    weights = out / "attention-lstm.onnx"
    write_file(
        weights,
        export(
            network,
            [1.0] * run.settings.num_leads,
            error_curves(marks) if network.settings.moves else None,
            half=True,
        ),
    )
    write_file(
        out / "model-card.md",
        model_card(asdict(run.settings), run.step, training, validation, marks),
    )
    return weights


def _append(path: Path, row: dict[str, float]) -> None:
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(row)
        writer.writerow([f"{value:.5g}" for value in row.values()])


def _board(folder: Path) -> Any:
    """Return a TensorBoard writer, or None where TensorBoard is not installed."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError:
        return None
    return SummaryWriter(str(folder))
