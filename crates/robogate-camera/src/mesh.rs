//! Triangle meshes with a bounding volume hierarchy.

use nalgebra::Vector3;

/// Largest number of triangles in a leaf.
const LEAF: usize = 4;

/// A triangle mesh about the centre of its bounding box.
#[derive(Debug)]
pub(crate) struct Mesh {
    /// A corner and the two edges from it, in metres.
    triangles: Vec<[Vector3<f32>; 3]>,
    nodes: Vec<Node>,
    half: [f32; 3],
}

/// A node of the tree: a box.
#[derive(Debug)]
struct Node {
    low: Vector3<f32>,
    high: Vector3<f32>,
    /// The index of the first triangle of a leaf; otherwise that of the second child. The first child follows the node.
    next: u32,
    /// Number of triangles in a leaf; 0 otherwise.
    count: u32,
}

impl Mesh {
    /// Creates a mesh of these triangles. Also returns the centre of its bounding box (m). `None` without a triangle of
    /// positive area.
    pub(crate) fn new(triangles: &[[Vector3<f64>; 3]]) -> Option<(Self, Vector3<f64>)> {
        let corners = || triangles.iter().flatten();
        let first = corners().next()?;
        let low = corners().fold(*first, |low, p| low.inf(p));
        let high = corners().fold(*first, |high, p| high.sup(p));
        let middle = 0.5 * (low + high);
        let mut local: Vec<[Vector3<f32>; 3]> =
            triangles.iter().map(|t| t.map(|p| (p - middle).map(|x| x as f32))).collect();
        local.retain(|[a, b, c]| (b - a).cross(&(c - a)).norm_squared() > 0.0);
        if local.is_empty() {
            return None;
        }
        let mut nodes = Vec::new();
        part(&mut local, 0, &mut nodes);
        let triangles = local.into_iter().map(|[a, b, c]| [a, b - a, c - a]).collect();
        Some((Self { triangles, nodes, half: (0.5 * (high - low)).map(|x| x as f32).into() }, middle))
    }

    /// Half extents of the bounding box, in metres.
    pub(crate) fn half(&self) -> [f32; 3] {
        self.half
    }

    /// The corners of each triangle, in metres.
    pub(crate) fn corners(&self) -> Vec<[[f32; 3]; 3]> {
        let corners = |[corner, along, across]: &[Vector3<f32>; 3]| {
            [(*corner).into(), (corner + along).into(), (corner + across).into()]
        };
        self.triangles.iter().map(corners).collect()
    }

    /// A triangle's normal, of any length.
    pub(crate) fn normal(&self, triangle: u32) -> Vector3<f32> {
        self.triangles.get(triangle as usize).map_or_else(Vector3::z, |[_, along, across]| along.cross(across))
    }

    /// First hit of a ray with the mesh, in multiples of its direction between `from` and `to`, and the triangle.
    pub(crate) fn first(&self, eye: &Vector3<f32>, direction: &Vector3<f32>, from: f32, to: f32) -> Option<(f32, u32)> {
        let inverse = direction.map(|x| 1.0 / if x.abs() < 1e-9 { 1e-9 } else { x });
        let mut found = None;
        let mut limit = to;
        let mut stack = [0_u32; 64];
        let mut depth = 1;
        while depth > 0 {
            depth -= 1;
            let index = stack[depth];
            let node = &self.nodes[index as usize];
            let a = (node.low - eye).component_mul(&inverse);
            let b = (node.high - eye).component_mul(&inverse);
            if a.inf(&b).max().max(from) > a.sup(&b).min().min(limit) {
                continue;
            }
            if node.count == 0 {
                if depth + 2 <= stack.len() {
                    (stack[depth], stack[depth + 1]) = (node.next, index + 1);
                    depth += 2;
                }
                continue;
            }
            for triangle in node.next..node.next + node.count {
                if let Some(t) = meet(&self.triangles[triangle as usize], eye, direction)
                    && t > from
                    && t < limit
                {
                    limit = t;
                    found = Some((t, triangle));
                }
            }
        }
        found
    }
}

/// Ray-triangle intersection (Möller and Trumbore 1997).
fn meet([corner, along, across]: &[Vector3<f32>; 3], eye: &Vector3<f32>, direction: &Vector3<f32>) -> Option<f32> {
    let p = direction.cross(across);
    let determinant = along.dot(&p);
    if determinant.abs() < 1e-14 {
        return None;
    }
    let s = eye - corner;
    let u = s.dot(&p) / determinant;
    let q = s.cross(along);
    let v = direction.dot(&q) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0).then(|| across.dot(&q) / determinant)
}

/// Adds a node for these triangles, whose first has the index `first`.
fn part(triangles: &mut [[Vector3<f32>; 3]], first: usize, nodes: &mut Vec<Node>) {
    let corners = || triangles.iter().flatten();
    let low = corners().fold(triangles[0][0], |low, p| low.inf(p));
    let high = corners().fold(triangles[0][0], |high, p| high.sup(p));
    let index = nodes.len();
    if triangles.len() <= LEAF {
        nodes.push(Node { low, high, next: first as u32, count: triangles.len() as u32 });
        return;
    }
    nodes.push(Node { low, high, next: 0, count: 0 });
    // Two halves with equal numbers of triangles bound the depth of the tree for all meshes.
    let axis = (high - low).imax();
    let middle = triangles.len() / 2;
    let place = |t: &[Vector3<f32>; 3]| t[0][axis] + t[1][axis] + t[2][axis];
    triangles.sort_by(|a, b| place(a).total_cmp(&place(b)));
    let (left, right) = triangles.split_at_mut(middle);
    part(left, first, nodes);
    nodes[index].next = nodes.len() as u32;
    part(right, first + middle, nodes);
}
