"""The paper's attention-LSTM network (section 3.2.1) in torch."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from e3pose.base.errors import InputError
from e3pose.predict.normalise import NUM_COMMON, NUM_CONTEXT, NUM_FEATURES

NUM_AXES = 3 * NUM_COMMON
KEEP = 4.0  # untrained, a joint keeps 98 % of its motion


@dataclass(frozen=True, slots=True)
class NetworkSettings:
    """Sizes of the network.

    Attributes:
        history_slots: the paper's M.
        hidden: width of the LSTMs.
        dropout: share of units dropped in training.
        experts: linear estimators of the newest places and motions, one per kind of history; 0
            for none.
        smooths: start from motions smoothed over the history.
        moves: the decoder keeps the joints moving, damps and changes that motion, and states its
            error; otherwise its regressor alone says what comes, as in the paper.
        displaces: where it alone does, it says how far joints move in a slot, in units of the
            person's speed; otherwise where they are. The paper leaves open which.
        context: motions, gaps, speed, slot length and roughness are inputs too; otherwise places
            alone, as in the paper.

    Raises:
        InputError: for experts or smoothing of a decoder that does not move joints.
    """

    history_slots: int = 10
    hidden: int = 96
    dropout: float = 0.2
    experts: int = 10
    smooths: bool = True
    moves: bool = True
    displaces: bool = False
    context: bool = True

    def __post_init__(self) -> None:
        if not self.moves and (self.experts or self.smooths):
            found = f"{self.experts} experts, smooths = {self.smooths}"
            raise InputError("network", found, "none of both where the decoder moves nothing")

    def as_published(self) -> NetworkSettings:
        """Return the network of the paper in the same size: none of the parts added to it."""
        return replace(self, experts=0, smooths=False, moves=False, displaces=True, context=False)


class AttentionLstm(nn.Module):
    """Encoder with input attention, temporal attention, decoder fed back once per lead.

    The decoder moves the joints on. It starts from the person's newest places and motions: those of
    the history, smoothed with weights that the encoder chooses, plus what a mixture of linear
    experts reads from all joints in all slots. In every slot it damps the motion by joint and adds
    to it, in units of the person's own speed.
    """

    def __init__(self, settings: NetworkSettings) -> None:
        super().__init__()
        self.settings = settings
        hidden, slots = settings.hidden, settings.history_slots
        self.input_attention = nn.Sequential(
            nn.Linear(NUM_FEATURES + hidden, 48), nn.Tanh(), nn.Linear(48, NUM_COMMON)
        )
        self.encoder = nn.LSTMCell(NUM_FEATURES + NUM_CONTEXT, hidden)
        if settings.smooths:
            self.smoothing = nn.Linear(hidden + NUM_CONTEXT, 2 * NUM_COMMON * (slots - 1))
        if settings.experts:
            self.gate = nn.Linear(NUM_CONTEXT + hidden, settings.experts)
            self.expert = nn.Linear(slots * NUM_AXES, settings.experts * 2 * NUM_AXES)
            self.expert.requires_grad_(False)  # a regression finds them, see `experts`
        self.query = nn.Linear(2 * hidden, 48)
        self.key = nn.Linear(hidden, 48, bias=False)
        self.energy = nn.Linear(48, 1, bias=False)
        self.entry = nn.Linear(2 * NUM_AXES + hidden + NUM_CONTEXT, hidden)
        self.decoder = nn.LSTMCell(hidden, hidden)
        self.reading = nn.Linear(2 * hidden, hidden)
        self.regressor = nn.Linear(hidden, NUM_AXES + NUM_COMMON * settings.moves)
        if settings.moves:
            self.doubt = nn.Linear(2 * hidden + NUM_CONTEXT, 48)
            self.error = nn.Linear(48, NUM_COMMON)
            self.coupling = nn.Linear(2 * NUM_AXES, NUM_AXES, bias=False)
        self.dropout = nn.Dropout(settings.dropout)
        given = torch.ones(NUM_FEATURES)
        given[NUM_AXES:] = float(settings.context)
        self.register_buffer("given", given, persistent=False)
        for name in ("smoothing", "gate", "expert", "regressor", "error", "coupling"):
            layer = getattr(self, name, None)
            if layer is not None:
                nn.init.zeros_(layer.weight)
                if layer.bias is not None:
                    nn.init.zeros_(layer.bias)

    def forward(self, features: Tensor, context: Tensor, num_leads: int) -> tuple[Tensor, Tensor]:
        """Predict.

        Args:
            features: `(history_slots, num_tracks, NUM_FEATURES)`, see `normalise`.
            context: `(num_tracks, NUM_CONTEXT)`.
            num_leads: how often the decoder is fed back.

        Returns:
            Places `(num_leads, num_tracks, NUM_COMMON, 3)` in metres in the people's frames and
            the logarithm of the expected error `(num_leads, num_tracks, NUM_COMMON)`, which means
            nothing where the decoder moves no joints.
        """
        state, memory = self.encode(features, context)
        places, errors = [], []
        for _ in range(num_leads):
            state, place, error = self.decode(state, memory)
            places.append(place)
            errors.append(error)
        shape = (num_leads, features.shape[1], 3, NUM_COMMON)
        return torch.stack(places).reshape(shape).transpose(-1, -2), torch.stack(errors)

    def encode(
        self, features: Tensor, context: Tensor
    ) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
        """Return the decoder's first state, and what it looks at in every step."""
        speed = 0.01 * torch.exp(context[:, :1])
        features, context = features * self.given, context * float(self.settings.context)
        hidden = cell = features.new_zeros(features.shape[1], self.settings.hidden)
        seen = []
        for slot in range(self.settings.history_slots):
            now = features[slot]
            weight = torch.softmax(self.input_attention(torch.cat([now, hidden], -1)), -1)
            chosen = now * (NUM_COMMON * weight).repeat(1, 7)
            hidden, cell = self.encoder(torch.cat([chosen, context], -1), (hidden, cell))
            seen.append(hidden)
        encoded = torch.stack(seen)
        place = features[-1, :, :NUM_AXES]
        motions = features[1:, :, NUM_AXES : 2 * NUM_AXES]
        motion = motions[-1]
        summary = torch.cat([context, self.dropout(hidden)], -1)
        if self.settings.smooths:
            weights = self.smoothing(summary)
            weights = weights.reshape(-1, 2, self.settings.history_slots - 1, NUM_COMMON)
            weights = weights.permute(1, 2, 0, 3).repeat(1, 1, 1, 3)
            motion = motion + (weights[0] * motions).sum(0)
            place = place + speed * (weights[1] * motions).sum(0)
        if self.settings.experts:
            share = torch.softmax(self.gate(summary), -1)
            found = self.expert(evidence(features, speed)).unflatten(-1, (-1, 2 * NUM_AXES))
            found = (share.unsqueeze(-1) * found).sum(1)
            motion = motion + found[:, NUM_AXES:] / speed
            place = place + found[:, :NUM_AXES]
        state = (hidden, cell, place, motion, torch.zeros_like(speed))
        return state, (encoded, self.key(encoded), context, speed)

    def decode(
        self, state: tuple[Tensor, ...], memory: tuple[Tensor, ...]
    ) -> tuple[tuple[Tensor, ...], Tensor, Tensor]:
        """Return the state one lead further, the places there and their expected log error."""
        hidden, cell, place, motion, lead = state
        encoded, keys, context, speed = memory
        query = self.query(torch.cat([hidden, cell], -1))
        weight = torch.softmax(self.energy(torch.tanh(query + keys)), 0)
        attended = (weight * encoded).sum(0)
        entry = torch.relu(self.entry(torch.cat([place, motion, attended, context], -1)))
        hidden, cell = self.decoder(self.dropout(entry), (hidden, cell))
        reading = torch.relu(self.reading(torch.cat([hidden, attended], -1)))
        if not self.settings.moves:
            said = self.regressor(self.dropout(reading))
            place = place + speed * said if self.settings.displaces else said
            unknown = place[:, :NUM_COMMON] * 0
            return (hidden, cell, place, motion, lead + 1), place, unknown
        change, keep = self.regressor(self.dropout(reading)).split([NUM_AXES, NUM_COMMON], -1)
        change = change + self.coupling(torch.cat([place, motion], -1))
        motion = motion * torch.sigmoid(keep + KEEP).repeat(1, 3) + change
        place = place + speed * motion
        lead = lead + 1
        # Learning how far off a prediction is does not change the prediction.
        seen = torch.cat([hidden.detach(), attended.detach(), context], -1)
        error = self.error(torch.relu(self.doubt(seen)))
        usual = torch.log(0.002 + 0.5 * speed * lead)
        return (hidden, cell, place, motion, lead), place, error + usual


def evidence(features: Tensor, speed: Tensor) -> Tensor:
    """Return the inputs of the experts: newest places in metres, then past motions in decimetres.

    Args:
        features: `(history_slots, num_tracks, NUM_FEATURES)`.
        speed: `(num_tracks, 1)` metres per slot.
    """
    motions = 10 * speed * features[1:, :, NUM_AXES : 2 * NUM_AXES]
    return torch.cat([features[-1, :, :NUM_AXES], motions.transpose(0, 1).flatten(1)], -1)
