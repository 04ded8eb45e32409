# In the editor: Tools > Execute Python Script. It makes a post-process volume over everything.
import os
import unreal

VALUES = {
@values@}
@grain@

def change(settings, values):
    """Sets properties of the settings, and says that they count."""
    for name, value in values.items():
        settings.set_editor_property("override_" + name, True)
        settings.set_editor_property(name, value)


settings = unreal.PostProcessSettings()
change(settings, VALUES)
@add_grain@actors = unreal.get_editor_subsystem(unreal.EditorActorSubsystem)
volume = actors.spawn_actor_from_class(unreal.PostProcessVolume, unreal.Vector(0.0, 0.0, 0.0))
volume.set_actor_label("Blindaug camera")
volume.set_editor_property("unbound", True)
volume.set_editor_property("settings", settings)
