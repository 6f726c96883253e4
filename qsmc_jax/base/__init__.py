"""The ground floor: module base class, array annotations, argument checks, elementary functions."""
