"""How many threads the linear algebra of the online loop runs on: one.

Products of the size that the loop needs gain nothing from a second thread, and a result that does
not depend on the number of cores is the same, bit for bit, in every process.
"""

from contextlib import AbstractContextManager

from threadpoolctl import threadpool_limits


def single_threaded_algebra() -> AbstractContextManager:
    """Limit BLAS to one thread: inside a `with` block, or from now on where it isn't entered."""
    return threadpool_limits(limits=1)
