"""General methods that explain a residual, each set up as its documents advise; packages are the extra "rivals".

A method gets inputs (n, p), a residual (n,), the number of the cycle of each (n,), and the model that it found in all
of the data where some cycles are left out now: that one keeps its structure (lengths, threshold, terms) as ours does.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import minimize

from shj_bayes._util.arrays import FloatArray, IntArray
from shj_validation.rivals.question import SENSE, WORDS

GP_STEPS = 30
GP_POINTS, FOKL_POINTS, POINTS = 300, 400, 4000  # of a question that a method gets, at most
FOKL_DRAWS = 50
ORDERS = 6  # of its terms, at most
FOKL_INPUTS = 4  # besides the direction: it lists all permutations of its inputs, 14! for all
BINS = 8  # of a coordinate, for which inputs FoKL gets
TERMS = 10  # of the sparse regression, at most
LIKE_BEST = 1.05  # of the least error in cycles held back: the sparsest that has no more is taken
EVERY = 8  # cycle that a method holds back to choose by, of those that it sees


@dataclass(frozen=True, eq=False)
class Model:
    """What a method found."""

    predict: Callable[[FloatArray], FloatArray]  # inputs (n, p) to what is added to the force, kN (n,)
    points: int  # that it was fitted to
    relevance: FloatArray | None = None  # shape (len(WORDS),): of each input, by what the method itself says
    permutes: bool = True  # whether inputs are permuted in cycles left out, too, to see what they matter
    structure: Any = None  # what a fit to fewer cycles keeps


Method = Callable[[FloatArray, FloatArray, FloatArray, Model | None], Model]


def some(n: int, most: int) -> IntArray:
    """Places of so many of n points at most, drawn without order so that they beat with no cycle."""
    return np.sort(np.random.default_rng(0).permutation(n)[:most])


def _climb(objective: Any, start: Any, bounds: Any) -> tuple[FloatArray, float]:
    """Find the most probable lengths as scikit-learn does, in so many steps at most."""
    best = minimize(objective, start, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": GP_STEPS})
    return best.x, float(best.fun)


def gaussian_process(x: FloatArray, y: FloatArray, cycle: FloatArray, known: Model | None) -> Model:
    """Gaussian process with a length for each input (ARD): the shorter it is, the more its input matters."""
    from sklearn.gaussian_process import GaussianProcessRegressor  # noqa: PLC0415
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel  # noqa: PLC0415

    own, scale = some(len(y), GP_POINTS), float(np.std(y))
    start = ConstantKernel(1.0, (1e-3, 1e3)) * RBF(np.ones(x.shape[1]), (0.05, 100.0)) + WhiteKernel(0.5, (1e-4, 10.0))
    kernel = start if known is None else known.structure
    fitted = GaussianProcessRegressor(kernel, optimizer=_climb if known is None else None)
    fitted.fit(x[own], y[own] / scale)
    lengths = fitted.kernel_.k1.k2.length_scale

    def predict(at: FloatArray) -> FloatArray:
        parts = np.array_split(at, max(1, len(at) // 5000))
        return scale * np.concatenate([fitted.predict(part) for part in parts])

    return Model(predict, len(own), 1.0 / lengths, structure=fitted.kernel_)


def boosting(x: FloatArray, y: FloatArray, cycle: FloatArray, known: Model | None) -> Model:
    """Gradient boosting, stopped by cycles that are held back; what matters is told by permutation."""
    from sklearn.ensemble import HistGradientBoostingRegressor  # noqa: PLC0415

    back = held_back(cycle)
    trees = HistGradientBoostingRegressor(
        learning_rate=0.1, max_iter=300, early_stopping=True, n_iter_no_change=10, random_state=0
    )
    trees.fit(x[~back], y[~back], X_val=x[back], y_val=y[back])
    return Model(trees.predict, len(y))


def held_back(cycle: FloatArray) -> Any:
    """Every eighth of the cycles that a method sees, to choose by."""
    _, number = np.unique(cycle, return_inverse=True)
    return number % min(EVERY, number.max() + 1) == min(EVERY, number.max() + 1) // 2


def sparse(x: FloatArray, y: FloatArray, cycle: FloatArray, known: Model | None) -> Model:
    """Sparse regression over cubics of each input and the same times the direction, one term after another (FROLS).

    How many terms is chosen by cycles that are held back; a coordinate matters by the error that its terms take away.
    """
    import pysindy as ps  # noqa: PLC0415

    own, scale, mean = some(len(y), POINTS), float(np.std(y)), float(np.mean(y))
    cubics = ps.PolynomialLibrary(3, include_interaction=False, include_bias=False)
    columns = [list(range(SENSE)), [SENSE]]
    library = ps.GeneralizedLibrary([cubics, ps.IdentityLibrary()], tensor_array=[[1, 1]], inputs_per_library=columns)

    def terms(at: FloatArray) -> FloatArray:
        return np.asarray(library.fit_transform(np.column_stack([2.0 * at[:, :SENSE] - 1.0, at[:, SENSE]])))

    a, target = terms(x), (y - mean) / scale
    unit = np.maximum(np.sqrt(np.mean(a**2, axis=0)), 1e-12)
    a /= unit

    def grown(rows: IntArray) -> tuple[list[int], FloatArray]:
        """Terms in the order in which they are chosen, and the share of the square error that each takes away."""
        greedy = ps.FROLS(max_iter=TERMS)
        greedy.fit(a[rows], target[rows, None])
        order: list[int] = []
        for one in greedy.history_:
            order += [int(i) for i in np.flatnonzero(one[0]) if i not in order]
        return order, greedy.ERR_global[: len(order), 0]

    def weights(rows: IntArray, chosen: list[int]) -> FloatArray:
        return np.asarray(np.linalg.lstsq(a[rows][:, chosen], target[rows], rcond=1e-8)[0])

    relevance = np.zeros(len(WORDS))
    if known is None:
        back = held_back(cycle[own])
        order, _ = grown(own[~back])
        wrong = []
        for k in range(len(order) + 1):
            fit = a[own[back]][:, order[:k]] @ weights(own[~back], order[:k])
            wrong.append(float(np.mean((target[own[back]] - fit) ** 2)))
        n = next(k for k, one in enumerate(wrong) if one <= LIKE_BEST * min(wrong))
        order, taken = grown(own)
        chosen = order[:n]
        for i, share in zip(chosen, taken, strict=False):
            relevance[_input_of(i)] += share
    else:
        chosen = known.structure
    beta = weights(own, chosen)
    return Model(
        lambda at: np.asarray(mean + scale * ((terms(at) / unit)[:, chosen] @ beta)), len(own), relevance, False, chosen
    )


def _input_of(term: int) -> int:
    """Input of a term of the library: cubics of all, the direction, cubics of all times the direction."""
    first, degree = 3 * SENSE, term if term < 3 * SENSE else term - 3 * SENSE - 1
    return SENSE if term == first else degree % SENSE


def fokl(x: FloatArray, y: FloatArray, cycle: FloatArray, known: Model | None) -> Model:
    """Bayesian Karhunen-Loeve regression with forward selection of terms, over the inputs that explain most alone."""
    from FoKL import getKernels  # noqa: PLC0415
    from FoKL.FoKLRoutines import FoKL  # noqa: PLC0415

    own, scale = some(len(y), FOKL_POINTS), float(np.std(y))
    if known is None:
        alone = [explained(x[own, i], x[own, SENSE], y[own]) for i in range(SENSE)]
        chosen = [*np.argsort(alone)[::-1][:FOKL_INPUTS], SENSE]
    else:
        chosen = known.structure[0]

    def normal(at: FloatArray) -> FloatArray:
        return np.asarray(np.clip(np.column_stack([at[:, :SENSE], (at[:, SENSE] + 1.0) / 2.0])[:, chosen], 0.0, 1.0))

    if known is None:
        phis = getKernels.bernoulli()[:ORDERS]
        quiet = {"UserWarnings": False, "ConsoleOutput": False}
        model = FoKL(kernel=1, phis=phis, burnin=FOKL_DRAWS, draws=FOKL_DRAWS, **quiet)
        np.random.seed(0)  # noqa: NPY002  it draws from there
        model.fit(normal(x[own]), y[own, None] / scale)
        terms = model.mtx.astype(int)
    else:
        terms, phis = known.structure[1:]

    def columns(at: FloatArray) -> FloatArray:
        out, u = np.ones((len(at), 1 + len(terms))), normal(at)
        for i, term in enumerate(terms, start=1):
            for j in np.flatnonzero(term):
                out[:, i] *= np.polynomial.polynomial.polyval(u[:, j], np.ravel(phis[term[j] - 1]))
        return out

    a = columns(x)
    ridge = 1e-6 * np.trace(a.T @ a) / a.shape[1] * np.eye(a.shape[1])
    beta = np.linalg.solve(a.T @ a + ridge, a.T @ y)
    return Model(lambda at: np.asarray(columns(at) @ beta), len(own), structure=(chosen, terms, phis))


def explained(u: FloatArray, sense: FloatArray, y: FloatArray) -> float:
    """Share of a residual that its means over bins of one input, in each direction, explain."""
    edges = np.quantile(u, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
    cell = 2 * np.searchsorted(edges, u) + (sense > 0.0)
    n = np.bincount(cell, minlength=2 * BINS)
    means = np.bincount(cell, weights=y, minlength=2 * BINS) / np.maximum(n, 1)
    return float(np.sum(n * (means - y.mean()) ** 2) / np.sum((y - y.mean()) ** 2))


METHODS: dict[str, Method] = {
    "gaussian process": gaussian_process,
    "sparse regression": sparse,
    "Karhunen-Loeve": fokl,
    "boosting": boosting,
}
assert len(WORDS) == SENSE + 1
