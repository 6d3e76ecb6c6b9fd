"""From a model to behaviour: policies, their search in imagination, planning at act time."""
