"""Who can hear whom: graphs, weights and their analysis; imports nothing of ours."""
