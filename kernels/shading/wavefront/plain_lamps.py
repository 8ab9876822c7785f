"""Lamps for W matte points at once: what `wrt.kernels.shading.wavefront.plain_step` does in lanes to gather their light.

The loop over lamps is not in lanes: lamps are few, and each is taken by the rays that chose it.
"""

LAMPS = """
    struct Found { V3 segment, direction, radiance; vf density; };
    auto find_interval = [](const float* sums, int count, float value) {
        int lowest = 0, highest = count;
        while (highest - lowest > 1) {
            const int middle = (lowest + highest) / 2;
            if (sums[middle] <= value) lowest = middle; else highest = middle;
        }
        return lowest;
    };
    auto within = [&](vf below, vf above, vf value) {
        return smaller(larger((value - below) / larger(above - below, all(1e-20f)), all(0.0f)), all(0.999999f));
    };
    auto on_flat = [&](const V3& target, const V3& axis, vf area, const V3& radiance, vi two_sided, vf lift, Found& found) {
        const V3 toward = target - lit_from;
        const vf distance = root(dot(toward, toward));
        found.direction = toward / distance;
        const vf slope = dot(found.direction, axis), cosine = pick(two_sided, size_of(-slope), -slope);
        found.segment = toward + axis * pick(slope < 0.0f, lift, -lift);
        found.radiance = radiance;
        found.density = pick((distance > 0.0f) & (cosine > 1e-6f), distance * distance / (cosine * area), all(0.0f));
    };
    auto sample_triangles = [&](vf x, vf y, Found& found) {
        int faces[W], numbers[W], sided[W];
        float values[W], below[W], above[W];
        save(values, x);
        const float* sums = lights.triangle_sums.data;
        WRT_SCALAR for (int i = 0; i < W; ++i) {
            const int number = find_interval(sums, (int)lights.triangle.shape[0], values[i]);
            below[i] = sums[number]; above[i] = sums[number + 1];
            faces[i] = lights.triangle.data[number];
            numbers[i] = materials.of_face.data[faces[i] * materials.of_face_stride];
            sided[i] = materials.two_sided.data[numbers[i]] != 0 ? -1 : 0;
        }
        const vf inner = within(load(below), load(above), x), side = root(inner);
        const Record lamp = records_of(faces);
        const V3 target = lamp.corner + lamp.edge1 * (side * (1.0f - y)) + lamp.edge2 * (side * y);
        const V3 radiance = colors_of(materials.emission.data, numbers);
        const vf bright = 0.2126f * radiance.x + 0.7152f * radiance.y + 0.0722f * radiance.z;
        const vf lift = OFFSET * reach(target);
        const vf area = lights.triangle_power / larger(bright, all(1e-30f));
        on_flat(target, lamp.normal, area, radiance, load_ints(sided), lift, found);
    };
    auto sample_sphere = [&](int entry, vf x, vf y, Found& found) {
        const V3 axis = all3(lights.position.data[entry]) - lit_from;
        const vf distance = root(dot(axis, axis)), radius = all(lights.shape.data[entry].c[2]);
        const vf sine = radius / distance, cosine = root(larger(all(0.0f), 1.0f - sine * sine));
        const vf cap = sine * sine / (1.0f + cosine), rest = x * cap, height = 1.0f - rest;
        const vf across = root(larger(all(0.0f), rest * (1.0f + height)));
        const V3 forward = axis / distance, tangent = tangent_of(forward);
        vf c, s;
        turned(y, c, s);
        const V3 aimed = forward * height + (tangent * c + cross(forward, tangent) * s) * across;
        found.direction = aimed / root(dot(aimed, aimed));
        const vf half = root(larger(all(0.0f), radius * radius - distance * distance * across * across));
        found.segment = found.direction * (height * distance - half);
        found.radiance = all3(lights.radiance.data[entry]);
        found.density = pick(distance > radius * 1.000001f, 1.0f / (TWO_PI * cap), all(0.0f));
    };
    auto sample_sky = [&](vf x, vf y, Found& found) {
        const float *rows = sky.row_sums.data, *cells = sky.cell_sums.data;
        const vf height = 1.0f - 2.0f * within(all(rows[0]), all(rows[1]), y);
        vf c, s;
        turned(within(all(cells[0]), all(cells[1]), x) - 0.5f, c, s);
        const vf radius = root(larger(all(0.0f), 1.0f - height * height));
        found.direction = (all3(sky.east) * c + all3(sky.north) * s) * radius + all3(sky.up) * height;
        found.segment = found.direction * lights.far;
        found.radiance = all3(sky.texels.data[0]);
        found.density = all(1.0f / (4.0f * PI));
    };
    auto sample_lamp = [&](int entry, vf x, vf y, Found& found) {  // whether only this way finds the light; -1: not in lanes
        const int kind = lights.kind.data[entry];
        const auto& shape = lights.shape.data[entry];
        found.radiance = all3(lights.radiance.data[entry]);
        found.density = all(1.0f);
        if (kind == POINT) {
            found.segment = all3(lights.position.data[entry]) - lit_from;
            const vf square = dot(found.segment, found.segment), distance = root(square);
            found.direction = found.segment / distance;
            found.radiance = found.radiance / larger(square, all(1e-30f));
            found.density = pick(distance > 0.0f, all(1.0f), all(0.0f));
            return 1;
        }
        if (kind == DIRECTIONAL) {
            found.direction = all3(lights.axis.data[entry]) * -1.0f;
            found.segment = found.direction * lights.far;
            return 1;
        }
        if (kind == PARALLELOGRAM || kind == TRIANGLE) {
            const vf side = root(x), s = kind == TRIANGLE ? side * (1.0f - y) : x, t = kind == TRIANGLE ? side * y : y;
            const V3 target = all3(lights.position.data[entry]) + all3(lights.edge1.data[entry]) * s
                + all3(lights.edge2.data[entry]) * t;
            const vi two_sided = (vi)(shape.c[3] != 0.0f ? -1 : 0);
            on_flat(target, all3(lights.axis.data[entry]), all(shape.c[2]), found.radiance, two_sided, all(0.0f), found);
            return 0;
        }
        if (kind == SPHERE) { sample_sphere(entry, x, y, found); return 0; }
        if (kind == TRIANGLES) { sample_triangles(x, y, found); return 0; }
        if (kind != SKY || lights.sky.width * lights.sky.height != 1 || lights.sky.rows * lights.sky.columns != 1) return -1;
        sample_sky(x, y, found);
        return 0;
    };
"""
"""C++: `sample_light` from `lit_from`, for W places on one lamp."""

GATHER = """
    V3 lit = {all(0.0f), all(0.0f), all(0.0f)}, segment = lit;
    if (samples_lights && lights.count > 0 && is_any(matte)) {
        vi entry = 0;
        if (lights.count > 1) {
            const vf chance = single_number(pixel, sample, 3 * generation);
            for (int e = 1; e < lights.count; ++e) entry -= lights.sums.data[e] <= chance;
        }
        vf x, y;
        pixel_point(pixel, sample, FIRST_BOUNCE + PER_BOUNCE * generation, x, y);
        for (int e = 0; e < lights.count; ++e) {
            const vi takes = matte & (entry == e);
            if (!is_any(takes)) continue;
            Found light;
            const int is_single = sample_lamp(e, x, y, light);
            if (is_single < 0) { matte = matte & (entry != e); continue; }
            const float probability = lights.count > 1 ? lights.sums.data[e + 1] - lights.sums.data[e] : 1.0f;
            const vf cosine = dot(normal, light.direction), scatters = size_of(cosine) / PI;
            const vf density = light.density * probability;
            vf share = 1.0f / density;
            if (!is_single) share = share * power_weight(density, scatters);
            const vi faces = (cosine > 0.0f) & (dot(light.direction, face_normal) > 0.0f);
            const vi arrives = takes & (light.density > 0.0f) & faces & (scatters > 0.0f);
            const V3 value = color * scatters;
            lit = pick3(arrives, weight * (value * light.radiance * share), lit);
            segment = pick3(arrives, light.segment - (lit_from + face_normal * offset - lit_from), segment);
        }
    }
"""
"""C++: `lamp_light`, for the matte ones."""
