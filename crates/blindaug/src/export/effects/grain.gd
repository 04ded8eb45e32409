# The noise of a camera, as a compositor effect for Godot 4.3 and later. Written by blindaug export.
# Import blindaug_grain.glsl as a shader and @bands@ as an Image, put this script beside them, and add a
# BlindaugGrain to the effects of the Compositor of a Camera3D or WorldEnvironment. It works before tonemapping: use linear.
@tool
class_name BlindaugGrain
extends CompositorEffect

## The noise's four octaves, finest first, in R, G, B, A.
@export var bands: Image = preload("@bands@")

# Std of each octave over encoded luminance, for R, then G, then B.
const SLOPE := [@slope@]
const INTERCEPT := [@intercept@]
const CLIP := @clip@

var device: RenderingDevice
var shader: RID
var pipeline: RID
var texture: RID
var model: RID
var random := RandomNumberGenerator.new()


func _init() -> void:
	effect_callback_type = EFFECT_CALLBACK_TYPE_POST_TRANSPARENT
	RenderingServer.call_on_render_thread(_prepare)


func _notification(what: int) -> void:
	if what == NOTIFICATION_PREDELETE and device:
		for resource: RID in [shader, texture, model]:
			if resource.is_valid():
				device.free_rid(resource)


func _prepare() -> void:
	device = RenderingServer.get_rendering_device()
	if not device:
		return
	var file: RDShaderFile = preload("blindaug_grain.glsl")
	shader = device.shader_create_from_spirv(file.get_spirv())
	pipeline = device.compute_pipeline_create(shader)
	var image := bands.duplicate() as Image
	image.convert(Image.FORMAT_RGBA8)
	var format := RDTextureFormat.new()
	format.width = image.get_width()
	format.height = image.get_height()
	format.format = RenderingDevice.DATA_FORMAT_R8G8B8A8_UNORM
	format.usage_bits = RenderingDevice.TEXTURE_USAGE_STORAGE_BIT | RenderingDevice.TEXTURE_USAGE_CAN_UPDATE_BIT
	texture = device.texture_create(format, RDTextureView.new(), [image.get_data()])
	var numbers := PackedFloat32Array(SLOPE + INTERCEPT + [CLIP, 0.0, 0.0, 0.0]).to_byte_array()
	model = device.uniform_buffer_create(numbers.size(), numbers)


func _render_callback(_callback_type: int, data: RenderData) -> void:
	var buffers := data.get_render_scene_buffers() as RenderSceneBuffersRD
	if not pipeline.is_valid() or not buffers:
		return
	var size := buffers.get_internal_size()
	if size.x == 0 or size.y == 0:
		return
	var offset := Vector2i(random.randi() & 0xffff, random.randi() & 0xffff)
	var constants := PackedInt32Array([offset.x, offset.y, size.x, size.y]).to_byte_array()
	for view in buffers.get_view_count():
		var uniforms: Array[RDUniform] = [
			_uniform(RenderingDevice.UNIFORM_TYPE_IMAGE, 0, buffers.get_color_layer(view)),
			_uniform(RenderingDevice.UNIFORM_TYPE_IMAGE, 1, texture),
			_uniform(RenderingDevice.UNIFORM_TYPE_UNIFORM_BUFFER, 2, model),
		]
		var list := device.compute_list_begin()
		device.compute_list_bind_compute_pipeline(list, pipeline)
		device.compute_list_bind_uniform_set(list, UniformSetCacheRD.get_cache(shader, 0, uniforms), 0)
		device.compute_list_set_push_constant(list, constants, constants.size())
		device.compute_list_dispatch(list, (size.x + 7) / 8, (size.y + 7) / 8, 1)
		device.compute_list_end()


func _uniform(type: RenderingDevice.UniformType, binding: int, resource: RID) -> RDUniform:
	var uniform := RDUniform.new()
	uniform.uniform_type = type
	uniform.binding = binding
	uniform.add_id(resource)
	return uniform
