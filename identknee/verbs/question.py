"""Names that `identknee.verbs.answer` holds, for modules that others edit now."""

from identknee.verbs.answer import has_priors as has_priors
