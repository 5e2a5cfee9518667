"""The weighted-average consensus UKF (Widjiantoro et al.)."""
