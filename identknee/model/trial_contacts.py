"""Where bones touch in the predicted pose of every trial."""

from identknee.mechanics.contact_places import ContactPlaces, contact_places
from identknee.model.laxity_model import LaxityModel
from identknee.model.prediction import Prediction


def trial_contacts(model: LaxityModel, prediction: Prediction) -> list[ContactPlaces]:
    """The contact of every trial in its predicted pose."""
    setting = model.setting(prediction.theta)
    flexion = setting.flexion[model.paths.trial_node]
    contact, field = model.surfaces(setting)
    return [
        contact_places(contact, field, float(angle), pose)
        for angle, pose in zip(flexion, prediction.poses, strict=True)
    ]
