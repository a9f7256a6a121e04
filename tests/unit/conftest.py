"""Pictures are left empty here."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _quick(empty_pictures: None) -> None:
    """What is tested here is not how pages look."""
