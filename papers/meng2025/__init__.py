"""The UKF under the FlexRay protocol (Meng et al., 2025)."""
