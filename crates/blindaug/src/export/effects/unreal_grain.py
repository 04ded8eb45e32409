
# "material": the camera's whole noise, as a post-process material after tonemapping.
# "film grain": the engine's own grain, with one strength for shadows, midtones and highlights each.
GRAIN = "material"
FILM_GRAIN = {
    "film_grain_intensity": 1.0,
    "film_grain_intensity_shadows": @shadows@,
    "film_grain_intensity_midtones": @midtones@,
    "film_grain_intensity_highlights": @highlights@,
    "film_grain_shadows_max": 0.09,
    "film_grain_highlights_min": 0.5,
    "film_grain_texel_size": 1.0,
}
# Where the textures and the material are put.
FOLDER = "/Game/Blindaug"
# The body of the material's function of Scene (the picture) and Bands (the noise's four octaves in R, G, B, A: 0.5 + gain n).
CODE = r"""
@code@"""


def texture(file):
    """Imports a texture that lies beside this script, as data: no colour space, no compression, read texel by texel."""
    task = unreal.AssetImportTask()
    task.filename = os.path.join(os.path.dirname(os.path.abspath(__file__)), file)
    task.destination_path = FOLDER
    task.automated = True
    task.replace_existing = True
    unreal.AssetToolsHelpers.get_asset_tools().import_asset_tasks([task])
    asset = unreal.load_asset(FOLDER + "/" + os.path.splitext(file)[0])
    if asset is None:
        raise RuntimeError(task.filename + " could not be imported; it must lie beside this script")
    asset.set_editor_property("srgb", False)
    asset.set_editor_property("compression_settings", unreal.TextureCompressionSettings.TC_VECTOR_DISPLACEMENTMAP)
    asset.set_editor_property("mip_gen_settings", unreal.TextureMipGenSettings.TMGS_NO_MIPMAPS)
    asset.set_editor_property("filter", unreal.TextureFilter.TF_NEAREST)
    unreal.EditorAssetLibrary.save_loaded_asset(asset)
    return asset


def material(bands):
    """Makes the post-process material that adds the noise."""
    name = "blindaug_grain_material"
    if unreal.EditorAssetLibrary.does_asset_exist(FOLDER + "/" + name):
        unreal.EditorAssetLibrary.delete_asset(FOLDER + "/" + name)
    tools = unreal.AssetToolsHelpers.get_asset_tools()
    made = tools.create_asset(name, FOLDER, unreal.Material, unreal.MaterialFactoryNew())
    made.set_editor_property("material_domain", unreal.MaterialDomain.MD_POST_PROCESS)
    # Version 5.4 gave the place another name.
    places = unreal.BlendableLocation
    renamed = hasattr(places, "BL_SCENE_COLOR_AFTER_TONEMAPPING")
    place = places.BL_SCENE_COLOR_AFTER_TONEMAPPING if renamed else places.BL_AFTER_TONEMAPPING
    made.set_editor_property("blendable_location", place)

    edit = unreal.MaterialEditingLibrary
    scene = edit.create_material_expression(made, unreal.MaterialExpressionSceneTexture, -700, 0)
    scene.set_editor_property("scene_texture_id", unreal.SceneTextureId.PPI_POST_PROCESS_INPUT0)
    octaves = edit.create_material_expression(made, unreal.MaterialExpressionTextureObject, -700, 250)
    octaves.set_editor_property("texture", bands)
    octaves.set_editor_property("sampler_type", unreal.MaterialSamplerType.SAMPLERTYPE_LINEAR_COLOR)
    function = edit.create_material_expression(made, unreal.MaterialExpressionCustom, -350, 0)
    function.set_editor_property("description", "Blindaug grain")
    function.set_editor_property("code", CODE)
    function.set_editor_property("output_type", unreal.CustomMaterialOutputType.CMOT_FLOAT3)
    inputs = []
    for input_name in ("Scene", "Bands"):
        one = unreal.CustomInput()
        one.set_editor_property("input_name", input_name)
        inputs.append(one)
    function.set_editor_property("inputs", inputs)
    edit.connect_material_expressions(scene, "Color", function, "Scene")
    edit.connect_material_expressions(octaves, "", function, "Bands")
    edit.connect_material_property(function, "", unreal.MaterialProperty.MP_EMISSIVE_COLOR)
    edit.recompile_material(made)
    unreal.EditorAssetLibrary.save_loaded_asset(made)
    return made


def add_grain(settings):
    """Adds the grain to the settings of the volume."""
    if GRAIN == "film grain":
        FILM_GRAIN["film_grain_texture"] = texture("@tile@")
        change(settings, FILM_GRAIN)
        return
    change(settings, {"film_grain_intensity": 0.0})
    blendable = unreal.WeightedBlendable(weight=1.0, object=material(texture("@bands@")))
    settings.set_editor_property("weighted_blendables", unreal.WeightedBlendables(array=[blendable]))
