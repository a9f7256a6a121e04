"""Checkpoints: everything needed to go on to the same bits, written whole or not at all."""

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from shj_bayes._util.files import open_ordinary, replacing
from shj_bayes.errors import CheckpointError, StrangeCheckpointError
from shj_bayes.model.parameters import FloatArray

SCHEMA = "shj-bayes/checkpoint/1"
ARRAYS = ("chain", "log_posterior", "accepted")
_KEYS = 624  # whole numbers of a Mersenne twister
_SEAL = b"SHA-256:"  # behind the HDF5 content, before the 32 bytes of its digest


@dataclass(frozen=True, eq=False)
class EnsembleState:
    """One ensemble as far as it has run; `ValueError` where its parts do not belong together."""

    chain: FloatArray  # shape (n_steps, n_walkers, d): positions in the unbounded space
    log_posterior: FloatArray  # shape (n_steps, n_walkers): log posterior density of each
    accepted: FloatArray  # shape (n_walkers,): accepted moves of each walker
    # state of the legacy Mersenne twister that emcee draws from (numpy's ``RandomState.get_state()``)
    random_state: tuple[Any, ...]
    n_failed: int  # evaluations with zero or overflowing density

    def __post_init__(self) -> None:
        """Refuse what no sampler leaves: numpy crashes on a wrong random state, and emcee passes over it in silence."""
        name, keys, position, has_gauss, _ = self.random_state
        parts = (self.chain, self.log_posterior, self.accepted)
        if not (
            self.chain.ndim == 3
            and self.chain.shape[:2] == self.log_posterior.shape
            and self.accepted.shape == self.chain.shape[1:2]
            and all(part.size and part.dtype.kind == "f" and np.isfinite(part).all() for part in parts)
            and name == "MT19937"
            and np.asarray(keys).dtype == np.uint32
            and np.shape(keys) == (_KEYS,)
            and 0 <= position <= _KEYS
            and has_gauss in (0, 1)
        ):
            raise ValueError("its chain or its random state is none that a fit leaves")


def save(path: Path, fingerprint: dict[str, str], ensembles: list[EnsembleState]) -> None:
    """Write a checkpoint beside the old one, then put it in its place."""
    # The latest format and Fletcher's sum protect headers and numbers: an altered byte is an error, not another chain.
    # Made in memory, then written as bytes: HDF5 itself makes a mess of a full disk.
    memory = io.BytesIO()
    with h5py.File(memory, "w", libver="latest") as file:
        file.attrs["schema"], file.attrs["n_ensembles"] = SCHEMA, len(ensembles)
        for key, value in fingerprint.items():
            file.attrs[f"fingerprint.{key}"] = value
        for number, ensemble in enumerate(ensembles):
            group = file.create_group(f"ensemble_{number}")
            name, keys, position, has_gauss, cached = ensemble.random_state
            arrays = {key: getattr(ensemble, key) for key in ARRAYS} | {"random_keys": np.asarray(keys)}
            for key, values in arrays.items():
                group.create_dataset(key, data=values, fletcher32=True)
            group.attrs.update(random_name=name, random_position=position, random_has_gauss=has_gauss)
            group.attrs.update(random_cached=cached, n_failed=ensemble.n_failed)
    with replacing(path) as part:
        content = memory.getvalue()
        part.write_bytes(content + _SEAL + hashlib.sha256(content).digest())


def load(path: Path, fingerprint: dict[str, str], shape: tuple[int, ...] | None = None) -> list[EnsembleState]:
    """Read a checkpoint of this very problem; `CheckpointError` where it is damaged, or says which fields differ.

    `shape` is (n_ensembles, n_walkers, d), where that is known.
    """
    try:
        # The digest comes first: a damaged file can make the HDF5 library end the process. HDF5 itself allows for bytes
        # behind its end, so other tools can open a checkpoint as it is.
        with open_ordinary(path) as stream:
            raw = stream.read()
        content, seal = raw[: -len(_SEAL) - 32], raw[-len(_SEAL) - 32 :]
        if seal != _SEAL + hashlib.sha256(content).digest():
            raise ValueError("it was cut short or altered: its digest does not fit")
        with h5py.File(io.BytesIO(content), "r") as file:
            if file.attrs.get("schema") != SCHEMA:
                raise CheckpointError(
                    f"{path.name}: schema {file.attrs.get('schema')!r}; this version reads {SCHEMA!r}"
                )
            strange = [key for key, value in fingerprint.items() if file.attrs.get(f"fingerprint.{key}") != value]
            if strange:
                raise StrangeCheckpointError(
                    f"{path.name} belongs to another problem: its {' and '.join(strange)} differ(s) from what is asked "
                    "now; choose another output folder, or delete the checkpoint to start anew"
                )
            states = [_read(file[f"ensemble_{number}"]) for number in range(int(file.attrs["n_ensembles"]))]
            kinds = {state.chain.shape for state in states}
            if len(kinds) != 1 or shape not in (None, (len(states), *kinds.pop()[1:])):
                raise ValueError("its ensembles are not those of this fit")
            return states
    except (OSError, KeyError, RuntimeError, TypeError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise CheckpointError(f"{path.name} cannot be read ({reason}); delete it to start anew") from error


def _read(group: h5py.Group) -> EnsembleState:
    a = group.attrs
    state = (str(a["random_name"]), np.asarray(group["random_keys"]), int(a["random_position"]))
    gauss = (int(a["random_has_gauss"]), float(a["random_cached"]))
    chain, log_posterior, accepted = (np.asarray(group[key]) for key in ARRAYS)
    return EnsembleState(chain, log_posterior, accepted, (*state, *gauss), int(a["n_failed"]))
