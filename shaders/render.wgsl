// Renders a frame; one invocation per pixel.

@group(1) @binding(0) var<uniform> params: FrameParams;
@group(1) @binding(1) var color_image: texture_storage_2d<rgba32float, write>;
@group(1) @binding(2) var normal_depth_image: texture_storage_2d<rgba32float, write>;
@group(1) @binding(3) var ids_image: texture_storage_2d<rgba32uint, write>;
// Number of pixels that needed more rays than params.max_rays.
@group(1) @binding(4) var<storage, read_write> limited_pixels: atomic<u32>;

@compute @workgroup_size(8, 8)
fn render(@builtin(global_invocation_id) id: vec3<u32>) {
    let y = params.first_row + id.y;
    if id.x >= params.width || y >= params.height {
        return;
    }
    let pixel = render_pixel(id.x, y);
    count_limited(pixel);
    textureStore(color_image, vec2<u32>(id.x, y), pixel.color);
}

@compute @workgroup_size(8, 8)
fn render_aovs(@builtin(global_invocation_id) id: vec3<u32>) {
    let y = params.first_row + id.y;
    if id.x >= params.width || y >= params.height {
        return;
    }
    let pixel = render_pixel(id.x, y);
    count_limited(pixel);
    textureStore(color_image, vec2<u32>(id.x, y), pixel.color);
    textureStore(normal_depth_image, vec2<u32>(id.x, y), vec4<f32>(pixel.normal, pixel.distance));
    textureStore(ids_image, vec2<u32>(id.x, y), pixel.ids);
}

fn count_limited(pixel: Pixel) {
    if pixel.is_limited {
        atomicAdd(&limited_pixels, 1u);
    }
}
