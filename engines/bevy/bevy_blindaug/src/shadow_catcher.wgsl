// A surface of the real scene on which virtual things cast shadows: black, as opaque as the shadow is dark.

#import bevy_pbr::forward_io::VertexOutput
#import bevy_pbr::mesh_view_bindings::{lights, view}
#import bevy_pbr::mesh_view_types::DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT
#import bevy_pbr::shadows::fetch_directional_shadow

// The share of the real light that comes from the lights that cast shadows.
@group(#{MATERIAL_BIND_GROUP}) @binding(0) var<uniform> strength: f32;

@fragment
fn fragment(in: VertexOutput) -> @location(0) vec4<f32> {
    let row = vec4<f32>(
        view.view_from_world[0].z,
        view.view_from_world[1].z,
        view.view_from_world[2].z,
        view.view_from_world[3].z,
    );
    let view_z = dot(row, in.world_position);
    let normal = normalize(in.world_normal);
    var without = 0.0;
    var with_shadows = 0.0;
    for (var i = 0u; i < lights.n_directional_lights; i++) {
        let light = &lights.directional_lights[i];
        let light_here = max(dot(normal, (*light).direction_to_light), 0.0) * dot((*light).color.rgb, vec3(1.0));
        var shadow = 1.0;
        if ((*light).flags & DIRECTIONAL_LIGHT_FLAGS_SHADOWS_ENABLED_BIT) != 0u {
            shadow = fetch_directional_shadow(i, in.world_position, normal, view_z, in.position.xy);
        }
        without += light_here;
        with_shadows += shadow * light_here;
    }
    let lost = select(0.0, 1.0 - with_shadows / without, without > 0.0);
    return vec4(0.0, 0.0, 0.0, strength * lost);
}
