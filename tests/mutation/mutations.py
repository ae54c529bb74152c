"""All faults, in the order they are tried."""

from blind_faults import FAULTS as BLIND

MUTATIONS = (*BLIND,)
