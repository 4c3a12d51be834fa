"""Every method by the name an operator gives: ours, then the baselines.

A new method is one file of this package that defines a `Method`; every list follows. Listing imports no torch.
"""

from collections.abc import Mapping

from acquisition.members import members
from reconstruction.methods.definition import Method

_FOUND = members("reconstruction.methods", Method)
OURS = tuple(method for method in _FOUND.values() if method.ours)
METHODS: Mapping[str, Method] = {method.name: method for method in (*OURS, *_FOUND.values())}
