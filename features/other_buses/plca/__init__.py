"""10BASE-T1S with PLCA: Ethernet on one pair, whose nodes send in turn."""
