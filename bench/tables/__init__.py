"""The tables of simcore/physics/data, from the packages that they come from."""
