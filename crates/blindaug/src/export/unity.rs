//! The parts that the two Unity targets share: the editor script that makes a volume profile, and the full-screen grain pass.

use super::{Camera, Export, File, filled, grain, head, number};

/// The name of the full-screen pass's file.
pub(super) const SHADER: &str = "BlindaugGrain.shader";

/// The number as a C# float literal.
pub(super) fn f(v: f32) -> String {
    format!("{}f", number(v))
}

/// The circle of confusion of both pipelines' physical cameras at a depth in m, as a share of the largest blur:
/// `clamp((1 - P / Z) (f_mm / N) F / (P - F), -1, 1)` without its sign, F = f_mm / 1000 m.
pub(super) fn coc(focal_length_mm: f32, f_number: f32, focus_m: f32, depth_m: f32) -> f32 {
    let focal_m = focal_length_mm / 1000.0;
    let max_coc = focal_length_mm / f_number * focal_m / (focus_m - focal_m);
    ((1.0 - focus_m / depth_m) * max_coc).abs().min(1.0)
}

/// Focal length in mm at which `(f_mm / N) F / (P - F) = max_coc`: the positive root of `1000 F^2 + max_coc N F - max_coc N P`.
pub(super) fn focal_length(max_coc: f32, f_number: f32, focus_m: f32) -> f32 {
    let b = f64::from(max_coc * f_number);
    let root = (b * b + 4000.0 * b * f64::from(focus_m)).sqrt();
    (1000.0 * (root - b) / 2000.0) as f32
}

/// The script of a pipeline (its name and its C# namespace) whose `body` sets motion blur and depth of field, with the film grain and its texture.
pub(super) fn export(
    camera: &Camera,
    [pipeline, namespace]: [&str; 2],
    mut body: String,
    response: Option<grain::Response>,
    mut lost: Vec<String>,
) -> Export {
    let mut textures = vec![];
    if let (Some(response), Some(noise)) = (&response, &camera.noise) {
        body += &film_grain(response);
        lost.extend(response.lost());
        textures.push(File::texture(grain::TILE, grain::tile(noise)));
    }
    let script = File::text("BlindaugCamera.cs", profile_script(pipeline, namespace, &lost, &body));
    Export { files: std::iter::once(script).chain(textures).collect(), lost }
}

/// An editor script with a menu entry that makes a volume profile; `body` fills the variable `profile`.
fn profile_script(pipeline: &str, namespace: &str, lost: &[String], body: &str) -> String {
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
fn film_grain(response: &grain::Response) -> String {
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
    let text = filled(include_str!("effects/grain.shader"), &grain::hlsl_values(noise));
    Some([File::text(SHADER, text), File::texture(grain::BANDS, grain::bands())])
}
