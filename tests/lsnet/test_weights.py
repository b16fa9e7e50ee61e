"""Weights files: round trip, and one line for anything else."""

from __future__ import annotations

import contextlib
import hashlib
import json
import time
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from memory import grows_by_less_than
from nets import TINY, save_tiny, tiny_net
from safetensors import safe_open
from safetensors.torch import load_file, save_file

from lsnet import Detector, weights_file
from lsnet.errors import LSNetError
from lsnet.weights import load_weights, save_weights
from lsnet.weights_file import WeightsCard, list_weights

if TYPE_CHECKING:
    from pathlib import Path


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    return save_tiny(tmp_path / "tiny.safetensors")


def header(path: Path) -> dict[str, str]:
    with safe_open(path, framework="pt") as opened:
        return opened.metadata()


def test_save_and_load_round_trip(tmp_path: Path) -> None:
    net, path = tiny_net(3), tmp_path / "w.safetensors"
    card = WeightsCard("mine", "fast", TINY, 0.4, 1.5, {"steps": 7}, {"ods": 0.8})
    sha256 = save_weights(path, net, card)
    loaded = load_weights(path)
    assert loaded.card == card
    assert loaded.sha256 == sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert not loaded.net.training
    for name, tensor in net.state_dict().items():
        assert torch.equal(loaded.net.state_dict()[name], tensor)
    image = torch.rand(1, 3, 32, 48)
    with torch.no_grad():
        assert torch.equal(loaded.net(image).logits, net(image).logits)
    assert json.loads(header(path)["lsnet"])["format"] == 1


def test_channels_last_weights_are_saved(tmp_path: Path) -> None:
    net = tiny_net().to(memory_format=torch.channels_last)
    save_weights(tmp_path / "w.safetensors", net, WeightsCard("a", "fast", TINY, 0.5))
    key = "extractor.0.0.weight"
    assert torch.equal(load_weights(tmp_path / "w.safetensors").net.state_dict()[key], net.state_dict()[key])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.pop("classifier.1.bias"), "Missing key"),
        (lambda t: t.update(other=torch.zeros(2)), "Unexpected key"),
        (lambda t: t.update({"classifier.1.bias": torch.zeros(3)}), "size mismatch"),
    ],
    ids=["missing", "extra", "wrong shape"],
)
def test_missing_extra_or_misshapen_tensors_are_refused(saved: Path, change: object, message: str) -> None:
    tensors, metadata = load_file(saved), header(saved)
    change(tensors)
    save_file(tensors, saved, metadata)
    with pytest.raises(LSNetError, match=message) as error:
        load_weights(saved)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 500


@pytest.mark.parametrize(
    "card",
    [
        None,
        "no json",
        "[]",
        "{}",
        '{"format": 2}',
        '{"format": 1}',
        '{"format": 1, "network": {"stage_channels": [4]}}',
        json.dumps({"format": 1, "name": "a", "surprise": 1}),
    ],
)
def test_other_cards_are_refused(saved: Path, card: str | None) -> None:
    save_file(load_file(saved), saved, None if card is None else {"lsnet": card})
    with pytest.raises(LSNetError, match="not weights that this version can use") as error:
        load_weights(saved)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("key", "value"), [("stage_channels", []), ("stage_channels", [4, -1]), ("norm", "group"), ("stem", 3)]
)
def test_other_networks_are_refused(saved: Path, key: str, value: object) -> None:
    card = json.loads(header(saved)["lsnet"])
    card["network"][key] = value
    save_file(load_file(saved), saved, {"lsnet": json.dumps(card)})
    with pytest.raises(LSNetError, match="not weights that this version can use"):
        load_weights(saved)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        *(("min_score", value) for value in ("x", None, [1], True, -1, 2)),
        *(("scale", value) for value in ("2", [1], 0, 1e9)),
        *(("name", 3), ("preset", None), ("recipe", []), ("metrics", "good")),
    ],
)
def test_card_values_of_another_type_or_range_are_refused(saved: Path, key: str, value: object) -> None:
    card = json.loads(header(saved)["lsnet"]) | {key: value}
    save_file(load_file(saved), saved, {"lsnet": json.dumps(card)})
    with pytest.raises(LSNetError, match=f"not weights that this version can use .wrong {key} in its card"):
        load_weights(saved)


@pytest.mark.parametrize("value", [[4096] * 3, [9000] * 3, [4] * 100_000, [4.5] * 3, [True] * 3])
def test_a_card_of_a_huge_network_costs_nothing(saved: Path, value: list[object]) -> None:
    card = json.loads(header(saved)["lsnet"])
    card["network"]["stage_channels"] = value
    save_file(load_file(saved), saved, {"lsnet": json.dumps(card)})
    started = time.process_time()
    with (
        grows_by_less_than(195),  # such layers take 1.7 GB
        pytest.raises(LSNetError, match="not weights that this version can use"),
    ):
        load_weights(saved)
    assert time.process_time() - started < 5


@pytest.mark.parametrize("card", ['{"a":' + "[" * 200_000, '{"format": ' + "9" * 5000 + "}", "x" * 2_000_000])
def test_deep_and_long_cards_are_one_short_line(saved: Path, card: str) -> None:
    save_file(load_file(saved), saved, {"lsnet": card})
    with pytest.raises(LSNetError, match="not weights that this version can use") as error:
        load_weights(saved)
    assert len(str(error.value)) < 500


def test_files_too_large_for_weights_are_not_read(tmp_path: Path) -> None:
    with (tmp_path / "big.safetensors").open("wb") as file:
        file.truncate(100 << 30)  # a hole: takes no space
    with pytest.raises(LSNetError, match=r"too large for weights \(102400 MiB\)"):
        load_weights(tmp_path / "big.safetensors")


@pytest.mark.parametrize("name", ["x" * 1_000_000, "a\nb", "a\0b"])
def test_names_that_are_not_paths_are_one_short_line(name: str) -> None:
    with pytest.raises(LSNetError, match="no such weights") as error:
        load_weights(name)
    assert len(str(error.value)) < 1000
    assert "\n" not in str(error.value)


def test_paths_may_be_strings(tmp_path: Path) -> None:
    path = str(tmp_path / "w.safetensors")
    sha256 = save_weights(path, tiny_net(), WeightsCard("a", "fast", TINY, 0.5))
    assert load_weights(path).sha256 == sha256


@pytest.mark.parametrize("length", [0, 7, 100, 2000])
def test_truncated_files_are_refused(saved: Path, length: int) -> None:
    saved.write_bytes(saved.read_bytes()[:length])
    with pytest.raises(LSNetError, match="not weights that this version can use"):
        load_weights(saved)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 1200), st.integers(0, 255))
def test_a_damaged_header_is_refused_or_harmless(tmp_path: Path, at: int, byte: int) -> None:
    path = save_tiny(tmp_path / "tiny.safetensors")
    data = bytearray(path.read_bytes())
    data[at] = byte
    path.write_bytes(data)
    with contextlib.suppress(LSNetError):
        load_weights(path)


def test_missing_files_are_refused(tmp_path: Path) -> None:
    for name in (tmp_path, tmp_path / "none", "nonesuch"):
        with pytest.raises(LSNetError, match=r"no such weights; give a \.safetensors file or a shipped name"):
            load_weights(name)
    with pytest.raises(LSNetError, match="cannot be written"):
        save_weights(tmp_path / "none/x", tiny_net(), WeightsCard("a", "fast", TINY, 0.5))


def test_shipped_weights_are_what_was_recorded() -> None:
    folder = resources.files("lsnet.pretrained")
    files = {f.name.removesuffix(".safetensors") for f in folder.iterdir() if f.name.endswith(".safetensors")}
    assert sorted(files) == list_weights()
    for name, sha256 in json.loads(folder.joinpath("sha256.json").read_text()).items():
        loaded = load_weights(name)
        data = folder.joinpath(f"{name}.safetensors").read_bytes()
        assert sha256 == loaded.sha256 == hashlib.sha256(data).hexdigest()
        assert loaded.card.name == name
        assert 0 < loaded.card.min_score < 1
        assert loaded.card.recipe
        assert loaded.card.metrics
        blank = np.full((64, 64, 3), 128, np.uint8)
        assert len(Detector.load(name, runtime="torch").detect([blank])[0].segments) == 0


def test_shipped_weights_that_changed_are_refused(saved: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(weights_file, "read_checksums", lambda: {"tiny": "0" * 64})
    monkeypatch.setattr(weights_file, "path_of", lambda _name: saved)
    with pytest.raises(LSNetError, match="damaged"):
        load_weights("tiny")
