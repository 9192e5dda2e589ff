"""Searches of whole frames for a model that is lost, now and then."""

from __future__ import annotations

import logging
from concurrent.futures import Future, ThreadPoolExecutor

from pwralign_kin.estimation import Estimate, EstimatorOptions
from pwralign_kin.estimation.estimator import Estimator
from pwralign_kin.estimation.second_looks import estimated
from pwralign_kin.exceptions import CorrespondenceError, ScanError
from pwralign_kin.model import ArticulatedModel
from pwralign_kin.scan import DepthFrame, Scan
from pwralign_kin.state import State
from pwralign_kin.tracking.frame_fitting import Frame

logger = logging.getLogger(__name__)

MOST_WAIT = 32
"""Frames between two searches, at most; the wait doubles from search to search."""


class Recovery:
    """Searches for a lost model around a guess and everywhere, in turn, in the frame or on a thread beside them."""

    def __init__(self, model: ArticulatedModel, options: EstimatorOptions, *, beside: bool) -> None:
        """Prepare searches; those `beside` the frames answer in a later frame."""
        self._estimator = Estimator(model, options)
        self._beside = beside
        self._pool: ThreadPoolExecutor | None = None
        self._search: Future[Estimate | None] | None = None
        self.found()

    def found(self) -> None:
        """Begin anew: the model is found."""
        self._wait, self._waited = 1, 0
        self.searches = 0

    @property
    def in_vain(self) -> bool:
        """Whether many searches have found nothing."""
        return self._wait == MOST_WAIT

    def answer(self, frame: Frame, guess: State | None, *, hidden: bool) -> Estimate | None:
        """Return what a search finds in a frame, or found in an earlier one, if one is due or done.

        The waits are longest while something hides the model.
        """
        if self._search is not None:
            if not self._search.done():
                return None
            search, self._search = self._search, None
            return search.result()
        self._waited += 1
        if self._waited < (MOST_WAIT if hidden else self._wait):
            return None
        self._waited, self._wait = 0, min(2 * self._wait, MOST_WAIT)
        self.searches += 1
        # Around a guess first; a guess confines the search in a scene, so every other search does without.
        guess = guess if self.searches % 2 else None
        if not self._beside:
            return self._estimate(frame, guess)
        self._pool = self._pool or ThreadPoolExecutor(1)
        self._search = self._pool.submit(self._estimate, frame, guess)
        return None

    def _estimate(self, frame: Frame, guess: State | None) -> Estimate | None:
        """Return the estimate of a frame, around a guess or everywhere; None where it cannot be made."""
        try:
            scan = frame.to_scan() if isinstance(frame, DepthFrame) else frame
            scan = scan if isinstance(scan, Scan) else Scan(scan)
            return estimated(self._estimator, scan, guess, None)
        except (ScanError, CorrespondenceError) as error:  # too little is seen
            logger.debug("search: %s", error)
            return None
