"""Whether what a client says that it holds is good."""

from mapperd.store.metadata import Identity
from mapperd.wire.messages import Interest, Resume

__all__ = ["why_not"]


def why_not(  # noqa: PLR0911 one reason each
    resume: Resume,
    interest: Interest,
    *,
    map_id: str,
    identity: Identity,
    looked: int,
    newest: int,
    has_losses: bool,
) -> str:
    """Why a client has to be told all; "" when what it holds is good.

    Args:
        resume: what it holds.
        interest: what it wants.
        map_id: as clients are told.
        identity: of the map.
        looked: the highest revision up to which anybody can have been told all.
        newest: of the map.
        has_losses: something of the map in the file was damaged.
    """
    held = (resume.level, resume.detail, resume.radius_m, resume.box)
    if resume.map != map_id:
        return "another_map"
    if held != (interest.level, interest.detail, interest.radius_m, interest.box):
        return "another_interest"
    if interest.radius_m > 0:
        return "moving_interest"  # where the vehicle was then is forgotten
    if resume.revision is None:
        return "never_complete"
    said = max(resume.revision, resume.newest or 0)
    if resume.session == identity.session:
        return "" if resume.revision <= looked and said <= newest else "never_told"
    kept = identity.valid_up_to(resume.session)
    if kept is None:
        return "unknown_session"
    if resume.newest is None or said > kept:
        return "not_kept"
    return "map_damaged" if has_losses else ""
