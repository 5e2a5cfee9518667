"""Several targets: births, deaths, clutter, association, tracks and their scores."""
