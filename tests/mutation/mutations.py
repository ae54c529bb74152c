"""All faults, in the order they are tried."""

from blind_faults import FAULTS as BLIND
from model_faults import FAULTS as MODEL
from statistics_faults import FAULTS as STATISTICS

MUTATIONS = (*BLIND, *MODEL, *STATISTICS)
