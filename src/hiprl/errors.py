"""The few kinds of error that hiprl reports; each message says what was found, what is needed, how to mend it."""


class HiprlError(Exception):
    """Anything hiprl tells its user; the command line prints the message alone and exits with 1."""


class InputError(HiprlError):
    """What came in cannot be used: a flag, an environment, an array. The command line exits with 2."""


class Answered(InputError):
    """A question that was open when it was shown was answered by somebody else in the meantime."""


class WorldError(HiprlError):
    """The environment broke while it ran: it raised, gave a value that is not finite, or changed shape."""


class JudgeError(HiprlError):
    """The judge gave no usable answer. The question stays open and can be answered later."""


class StoreError(HiprlError):
    """The store cannot be opened, read or written."""


class FitDiverged(HiprlError):
    """Training a model gave a loss that is not finite."""
