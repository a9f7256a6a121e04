"""Proof on data where the effect is concealed: independent simulators, sealed keys, blind diagnosis, score.

cases -> simulators -> seal -> run (diagnosis behind a fence) -> open -> score -> page
"""
