"""The one door from what users install to what validates it; nothing else here imports `shj_validation`."""

from shj_validation.paper_claims import paper_claims
from shj_validation.proof.check import check
from shj_validation.proof.real import prove_recordings
from shj_validation.proof.run import prove

__all__ = ["check", "paper_claims", "prove", "prove_recordings"]
