"""The avatar: several identities blended into one controllable face that belongs to nobody (Nagle section 4)."""

from morphspace.avatar.build import Avatar, blend_steps
from morphspace.avatar.settings import AvatarSettings, Expression

__all__ = ["Avatar", "AvatarSettings", "Expression", "blend_steps"]
