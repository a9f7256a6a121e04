"""A bench that runs, on an empty folder."""

from collections.abc import Iterator

import pytest
from serving import Served


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A bench on an empty folder, with a cookie."""
    bench = Served.on(tmp_path_factory.mktemp("bench") / "spring series")
    bench.enter()
    yield bench
    said = bench.end()
    assert "the bench is ended" in said
    assert "Traceback" not in said
    assert not bench.way_in.exists()
