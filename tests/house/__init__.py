"""House rules over the whole product: circles, folders, names, dead functions, large classes."""
