"""What stamps mean to those who keep something from one state to the next."""

NANOSECOND = 1e-9  # s
LONGEST_GAP = 0.5  # s between two stamps of one motion; after a longer one all begins anew
