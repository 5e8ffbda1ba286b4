"""The networks of `palpate-train bench-policy` in PyTorch, on one thread.

Reads the sizes as one line of JSON. "infer N" turns N observations into actions, one at a time: the tactile encoder, then trunk and ten
steps of DDIM through the U-Net. "learn" makes one step of learning of the policy on a batch. Both are answered with their times.
"""

import json
import math
import sys
import time

import torch
from torch import nn
from torch.nn import functional

torch.set_num_threads(1)
torch.set_num_interop_threads(1)
sizes = json.loads(sys.stdin.readline())
STEP_DIM = 64


class Encoder(nn.Module):
    """A Transformer that normalises before each part, over frames of taxels."""

    def __init__(self) -> None:
        super().__init__()
        width = sizes["width"]
        self.input = nn.Linear(sizes["channels"] * 4, width)
        self.positions = nn.Parameter(torch.randn(sizes["history"], width) * 0.1)
        layer = nn.TransformerEncoderLayer(
            width, sizes["heads"], sizes["feed_forward"], dropout=0.0, batch_first=True, norm_first=True
        )
        self.layers = nn.TransformerEncoder(layer, sizes["layers"], norm=nn.LayerNorm(width), enable_nested_tensor=False)

    def forward(self, windows: torch.Tensor) -> torch.Tensor:
        return self.layers(self.input(windows) + self.positions)[:, -1]


class Block(nn.Module):
    """Two convolutions; what stands between them is told the condition by FiLM."""

    def __init__(self, inputs: int, outputs: int, condition: int) -> None:
        super().__init__()
        kernel = sizes["kernel"]
        self.first = nn.Conv1d(inputs, outputs, kernel, padding=kernel // 2)
        self.second = nn.Conv1d(outputs, outputs, kernel, padding=kernel // 2)
        self.norms = nn.ModuleList([nn.LayerNorm(outputs), nn.LayerNorm(outputs)])
        self.film = nn.Linear(condition, 2 * outputs)
        self.residual = nn.Conv1d(inputs, outputs, 1) if inputs != outputs else nn.Identity()

    def forward(self, signal: torch.Tensor, condition: torch.Tensor) -> torch.Tensor:
        rows = functional.silu(self.norms[0](self.first(signal).transpose(1, 2)))
        scale, shift = self.film(functional.silu(condition))[:, None].chunk(2, dim=2)
        rows = rows * (1 + scale) + shift
        rows = functional.silu(self.norms[1](self.second(rows.transpose(1, 2)).transpose(1, 2)))
        return rows.transpose(1, 2) + self.residual(signal)


class Policy(nn.Module):
    """Trunk and U-Net."""

    def __init__(self) -> None:
        super().__init__()
        widths = [sizes["input_len"], *sizes["trunk"]]
        parts: list[nn.Module] = []
        for inputs, outputs in zip(widths, widths[1:]):
            parts += [nn.Linear(inputs, outputs), nn.SiLU()]
        self.trunk = nn.Sequential(*parts)
        self.step = nn.Sequential(nn.Linear(STEP_DIM, 4 * STEP_DIM), nn.SiLU(), nn.Linear(4 * STEP_DIM, STEP_DIM))
        outer, inner = sizes["unet"]
        condition = widths[-1] + STEP_DIM
        pairs = [(sizes["action_len"], outer), (outer, outer), (outer, inner), (inner, inner), (inner, inner), (inner, inner)]
        pairs += [(2 * inner, outer), (outer, outer)]
        self.blocks = nn.ModuleList([Block(inputs, outputs, condition) for inputs, outputs in pairs])
        self.downsample = nn.Conv1d(outer, outer, 2, stride=2)
        self.upsample = nn.ConvTranspose1d(outer, outer, 2, stride=2)
        kernel = sizes["kernel"]
        self.last = nn.Conv1d(outer, outer, kernel, padding=kernel // 2)
        self.norm = nn.LayerNorm(outer)
        self.output = nn.Conv1d(outer, sizes["action_len"], 1)

    def noise(self, features: torch.Tensor, noisy: torch.Tensor, steps: torch.Tensor) -> torch.Tensor:
        half = STEP_DIM // 2
        angles = steps[:, None] * torch.exp(-math.log(10_000) * torch.arange(half) / (half - 1))
        condition = torch.cat([features, self.step(torch.cat([angles.sin(), angles.cos()], dim=1))], dim=1)
        signal = noisy.transpose(1, 2)
        for block in self.blocks[:2]:
            signal = block(signal, condition)
        signal = self.downsample(signal)
        for block in self.blocks[2:4]:
            signal = block(signal, condition)
        skipped = signal
        for block in self.blocks[4:6]:
            signal = block(signal, condition)
        signal = torch.cat([signal, skipped], dim=1)
        for block in self.blocks[6:]:
            signal = block(signal, condition)
        signal = self.last(self.upsample(signal)).transpose(1, 2)
        return self.output(functional.silu(self.norm(signal)).transpose(1, 2)).transpose(1, 2)


encoder, policy = Encoder().eval(), Policy()
optimiser = torch.optim.AdamW(policy.parameters(), lr=1e-4, weight_decay=1e-6)
window = torch.randn(1, sizes["history"], sizes["channels"] * 4)
seen = torch.randn(1, sizes["input_len"])
chunk_shape = (sizes["predicted"], sizes["action_len"])


def infer() -> tuple[float, float]:
    """One observation to one chunk: times of encoder and policy."""
    with torch.inference_mode():
        began = time.perf_counter()
        encoder(window)
        encoded = time.perf_counter()
        features = policy.trunk(seen)
        chunk = torch.randn(1, *chunk_shape)
        for step in range(sizes["sampled_steps"]):
            predicted = policy.noise(features, chunk, torch.tensor([float(step)]))
            clean = ((chunk - 0.5 * predicted) / 0.9).clamp(-6, 6)
            chunk = 0.95 * clean + 0.3 * predicted
        return encoded - began, time.perf_counter() - encoded


def learn() -> float:
    """One step of AdamW on a batch that is there already: its time."""
    batch = sizes["batch_size"]
    inputs, noisy, noise = torch.randn(batch, sizes["input_len"]), torch.randn(batch, *chunk_shape), torch.randn(batch, *chunk_shape)
    steps = torch.randint(0, 50, (batch,)).float()
    began = time.perf_counter()
    optimiser.zero_grad()
    functional.mse_loss(policy.noise(policy.trunk(inputs), noisy, steps), noise).backward()
    nn.utils.clip_grad_norm_(policy.parameters(), 1.0)
    optimiser.step()
    return time.perf_counter() - began


infer()
learn()
for line in sys.stdin:
    command, *count = line.split()
    answer: dict[str, list[float]] = {"encoder": [], "policy": [], "policy_step": []}
    if command == "infer":
        for _ in range(int(count[0])):
            encoder_s, policy_s = infer()
            answer["encoder"].append(encoder_s)
            answer["policy"].append(policy_s)
    else:
        answer["policy_step"].append(learn())
    print(json.dumps(answer), flush=True)
