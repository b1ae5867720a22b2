"""What can go wrong. The words are those of the program."""


class RaysetError(Exception):
    """The base of all errors of rayset that are not mistakes in a call (these are ``TypeError`` and ``ValueError``)."""


class InputError(RaysetError):
    """A file cannot be opened or read, or is not what it should be; the words say which, where, and what to do."""


class BuildError(RaysetError):
    """A cloud or a grid cannot be built of what was given."""


class SceneError(RaysetError, ValueError):
    """A scene, a look or a camera is not valid; the words begin with the key."""


class RenderError(RaysetError):
    """A picture cannot be rendered: a page of a file is damaged, a session is closed."""


class MemoryBudgetError(RaysetError, MemoryError):
    """``memory=`` is too small; the words say how much would do."""


class Cancelled(RaysetError):
    """Something was stopped before it was finished."""


class ExecutorError(RaysetError):
    """The workers of an ``executor=`` cannot do the work: the scheduler is gone, there are no workers, or they do not fit together."""


class RaysetWarning(UserWarning):
    """Something that a person should look at: points that were skipped, caps that were left out."""
