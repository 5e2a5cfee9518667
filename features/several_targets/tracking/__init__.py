"""Several targets: tracks with existence probabilities, and scores of sets of tracks."""
