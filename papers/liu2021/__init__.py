"""Set-membership estimation over FlexRay (Liu et al., 2021)."""
