"""Pictures and builds by the workers of a ``dask.distributed`` client.

``pool`` asks the workers what they are, ``tasks`` hands work out and takes results, ``pictures`` and ``builds`` say what the work is, ``folder``
is where parts of a build meet, and ``worker`` is what runs over there.
"""
