//! What the two Unity targets share: the editor script that makes a volume profile, and the full-screen grain pass.

use super::{Camera, File, filled, grain, head, number, numbers};

/// The file of the full-screen pass.
pub(super) const SHADER: &str = "BlindaugGrain.shader";

/// A C# literal.
pub(super) fn f(v: f32) -> String {
    format!("{}f", number(v))
}

/// An editor script with a menu entry that makes a volume profile; `body` fills the variable `profile`.
pub(super) fn profile_script(pipeline: &str, namespace: &str, lost: &[String], body: &str) -> String {
    let head = head("//", &format!("A camera as a volume profile of Unity's {pipeline}"), lost);
    let texture = grain::TILE;
    format!(
        r#"{head}// Put this file into Assets/Editor and {texture} into Assets, then choose Assets > Create > Blindaug camera profile.
using UnityEditor;
using UnityEngine;
using UnityEngine.Rendering;
using {namespace};

public static class BlindaugCamera
{{
    [MenuItem("Assets/Create/Blindaug camera profile")]
    static void Create()
    {{
        var profile = ScriptableObject.CreateInstance<VolumeProfile>();
        AssetDatabase.CreateAsset(profile, AssetDatabase.GenerateUniqueAssetPath("Assets/Blindaug camera.asset"));
{body}        AssetDatabase.SaveAssets();
    }}

    static T Add<T>(VolumeProfile profile) where T : VolumeComponent
    {{
        var component = profile.Add<T>();
        AssetDatabase.AddObjectToAsset(component, profile);
        return component;
    }}

    // Data, not colours: no colour space, no compression, read texel by texel.
    static Texture2D Data(string path)
    {{
        if (AssetImporter.GetAtPath(path) is TextureImporter importer)
        {{
            importer.sRGBTexture = false;
            importer.alphaIsTransparency = false;
            importer.mipmapEnabled = false;
            importer.filterMode = FilterMode.Point;
            importer.wrapMode = TextureWrapMode.Repeat;
            importer.textureCompression = TextureImporterCompression.Uncompressed;
            importer.SaveAndReimport();
        }}
        return AssetDatabase.LoadAssetAtPath<Texture2D>(path);
    }}
}}
"#
    )
}

/// The part of the script that sets the pipeline's film grain.
pub(super) fn film_grain(response: &grain::Response) -> String {
    let (texture, intensity, response) = (grain::TILE, f(response.intensity), f(response.response));
    format!(
        r#"
        var grain = Add<FilmGrain>(profile);
        grain.type.Override(FilmGrainLookup.Custom);
        grain.texture.Override(Data("Assets/{texture}"));
        grain.intensity.Override({intensity});
        grain.response.Override({response});
"#
    )
}

/// The whole noise model as a full-screen pass: for the Full Screen Pass renderer feature of URP 14 and later, after
/// post-processing, instead of the film grain.
pub(super) fn grain_shader(camera: &Camera) -> Option<[File; 2]> {
    let noise = camera.noise.as_ref()?;
    let (slope, intercept) = grain::by_channel(noise);
    let vectors = |v: [[f32; 4]; 3]| v.map(|v| format!("float4({})", numbers(&v))).join(", ");
    let text = filled(
        include_str!("effects/grain.shader"),
        &[
            ("bands", grain::BANDS.into()),
            ("slope", vectors(slope)),
            ("intercept", vectors(intercept)),
            ("offsets", grain::CHANNEL_OFFSETS.map(|[x, y]| format!("int2({x}, {y})")).join(", ")),
            ("clip", number(noise.clip)),
            ("mask", (grain::SIDE - 1).to_string()),
            ("gain", number(grain::GAIN)),
        ],
    );
    Some([File::text(SHADER, text), File::texture(grain::BANDS, grain::bands())])
}
