//! Reads triangle meshes: STL (binary or text) and Wavefront OBJ. Time and memory are proportional to the size of the file.

use std::fmt;

use nalgebra::{Point3, Vector3};

/// Most corners of one polygon of an OBJ file.
const MOST_CORNERS: usize = 1_000;

/// Vertices, and triangles as their indices.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Triangles {
    /// The vertices, in units of the file.
    pub vertices: Vec<Point3<f64>>,
    /// The triangles, counter-clockwise seen from outside. Empty if the file has vertices only.
    pub faces: Vec<[u32; 3]>,
}

/// What is wrong with a mesh file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MeshProblem {
    /// The line, from 1, if the file is text.
    pub line: Option<usize>,
    /// What is wrong, and what was expected.
    pub what: String,
}

impl fmt::Display for MeshProblem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.line {
            Some(line) => write!(f, "line {line}: {}", self.what),
            None => f.write_str(&self.what),
        }
    }
}

impl From<String> for MeshProblem {
    fn from(what: String) -> Self {
        Self { line: None, what }
    }
}

impl Triangles {
    /// Reads a file with at most `most` triangles.
    ///
    /// # Errors
    /// What is wrong with the file, with its line.
    pub fn read(bytes: &[u8], most: usize) -> Result<Self, MeshProblem> {
        let whole = |what: &str| Err(MeshProblem::from(what.to_owned()));
        if bytes.starts_with(b"version https://git-lfs") {
            return whole("it is a pointer of Git LFS, not the mesh. Fetch the file with `git lfs pull`");
        }
        let counted = bytes.get(80..84).map(|n| u32::from_le_bytes([n[0], n[1], n[2], n[3]]) as usize);
        if let Some(triangles) = counted.filter(|count| *count > 0 && bytes.len() == 84 + 50 * count) {
            limited(triangles, most)?;
            return Self::binary_stl(&bytes[84..]);
        }
        let Ok(text) = std::str::from_utf8(bytes) else {
            return match counted {
                Some(count) => Err(format!(
                    "it is neither text nor a binary STL: it has {} bytes, but the {count} triangles that byte 80 states need {}",
                    bytes.len(),
                    84 + 50 * count as u64
                )
                .into()),
                None => whole("it is neither STL nor OBJ"),
            };
        };
        let mut words = text.split_whitespace();
        match words.next() {
            Some("ply") => return whole("it is a PLY file. Expected STL or OBJ"),
            Some(word) if word.starts_with('<') => return whole("it is an XML file. Expected STL or OBJ"),
            _ => {}
        }
        let mut reader = Reader { most, ..Reader::default() };
        for (number, line) in text.lines().enumerate() {
            reader.line(line).map_err(|what| MeshProblem { line: Some(number + 1), what })?;
        }
        let Reader { read, corners, .. } = reader;
        if read.vertices.is_empty() {
            return whole("it is neither STL nor OBJ: it has no vertices");
        }
        if !corners.is_multiple_of(3) {
            return whole("the last facet has not three vertices");
        }
        Ok(read)
    }

    fn binary_stl(bytes: &[u8]) -> Result<Self, MeshProblem> {
        let number = |b: &[u8]| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        let mut read = Self::default();
        for (index, triangle) in bytes.chunks_exact(50).enumerate() {
            for corner in triangle[12..48].chunks_exact(12) {
                let point = Point3::new(number(corner), number(&corner[4..]), number(&corner[8..]));
                if !point.iter().all(|x| x.is_finite()) {
                    return Err(format!("triangle {} has a coordinate that is not finite", index + 1).into());
                }
                read.vertices.push(point);
            }
            let first = 3 * index as u32;
            read.faces.push([first, first + 1, first + 2]);
        }
        Ok(read)
    }
}

fn limited(triangles: usize, most: usize) -> Result<(), String> {
    if triangles <= most {
        return Ok(());
    }
    Err(format!("it has more than {most} triangles. Reduce their number in a mesh editor (`decimate`)"))
}

/// A text that is being read. OBJ and STL have no line in common.
#[derive(Debug, Default)]
struct Reader {
    most: usize,
    read: Triangles,
    /// The number of vertices of facets of an STL.
    corners: usize,
}

impl Reader {
    fn line(&mut self, line: &str) -> Result<(), String> {
        let mut words = line.split_whitespace();
        match words.next() {
            Some("v") => self.vertex(words),
            Some("vertex") => {
                self.vertex(words)?;
                self.corners += 1;
                if self.corners.is_multiple_of(3) {
                    let last = self.read.vertices.len() as u32;
                    self.read.faces.push([last - 3, last - 2, last - 1]);
                }
                limited(self.read.faces.len(), self.most)
            }
            Some("f") => {
                let corners = words.map(|word| self.corner(word)).collect::<Result<Vec<_>, _>>()?;
                if !(3..=MOST_CORNERS).contains(&corners.len()) {
                    return Err(format!("a face has {} corners. Expected 3 to {MOST_CORNERS}", corners.len()));
                }
                self.polygon(corners)?;
                limited(self.read.faces.len(), self.most)
            }
            _ => Ok(()),
        }
    }

    fn vertex<'a>(&mut self, words: impl Iterator<Item = &'a str>) -> Result<(), String> {
        let mut point = [0.0; 3];
        let mut count = 0;
        for (at, word) in point.iter_mut().zip(words) {
            let number = word.parse::<f64>().ok().filter(|number| number.is_finite());
            *at = number.ok_or_else(|| format!("`{}` is not a number", word.chars().take(40).collect::<String>()))?;
            count += 1;
        }
        if count < 3 {
            return Err(format!("a vertex has {count} numbers. Expected three"));
        }
        // No file of this size has so many vertices.
        if self.read.vertices.len() >= u32::MAX as usize {
            return Err("it has too many vertices".to_owned());
        }
        self.read.vertices.push(point.into());
        Ok(())
    }

    /// The index of a corner such as `3`, `3/1`, `3//2` or `-1`. Negative numbers count back from the last vertex so far.
    fn corner(&self, word: &str) -> Result<u32, String> {
        let count = self.read.vertices.len() as i64;
        let number = word.split('/').next().and_then(|number| number.parse::<i64>().ok());
        let index = number.map(|number| if number < 0 { count + number } else { number - 1 });
        match index.filter(|index| (0..count).contains(index)) {
            Some(index) => Ok(index as u32),
            None => Err(format!(
                "the face names the vertex `{}`. Expected one of the {count} vertices above it",
                word.chars().take(40).collect::<String>()
            )),
        }
    }

    /// Adds the triangles of a flat polygon.
    fn polygon(&mut self, mut corners: Vec<u32>) -> Result<(), String> {
        let at = |index: u32| self.read.vertices[index as usize].coords;
        // Newell's method: a normal whose length is twice the area. It holds for polygons that are not convex too.
        let pairs = || corners.iter().zip(corners.iter().cycle().skip(1));
        let origin = at(corners[0]);
        let normal: Vector3<f64> = pairs().map(|(a, b)| (at(*a) - origin).cross(&(at(*b) - origin))).sum();
        let area = |a: u32, b: u32, c: u32| (at(b) - at(a)).cross(&(at(c) - at(a))).dot(&normal);
        let fan = || corners.windows(2).skip(1).map(|pair| [corners[0], pair[0], pair[1]]);
        if fan().all(|[a, b, c]| area(a, b, c) >= 0.0) {
            let triangles: Vec<_> = fan().collect();
            self.read.faces.extend(triangles);
            return Ok(());
        }
        // A polygon with a notch: cut off corners that contain no other one ("ear clipping", Meisters 1975).
        let mut found = Vec::new();
        while corners.len() > 3 {
            let count = corners.len();
            let ear = (0..count).find(|ear| {
                let [a, b, c] = [0, 1, 2].map(|next| corners[(ear + next) % count]);
                let within = |p: &u32| area(a, b, *p) >= 0.0 && area(b, c, *p) >= 0.0 && area(c, a, *p) >= 0.0;
                area(a, b, c) > 0.0 && !corners.iter().any(|p| ![a, b, c].contains(p) && within(p))
            });
            let ear = ear.ok_or("the polygon crosses itself. Let the mesh editor write triangles")?;
            found.push([0, 1, 2].map(|next| corners[(ear + next) % count]));
            corners.remove((ear + 1) % count);
        }
        found.push([corners[0], corners[1], corners[2]]);
        self.read.faces.extend(found);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Result<Triangles, MeshProblem> {
        Triangles::read(bytes, 100)
    }

    fn points(read: &Triangles) -> Vec<f64> {
        read.vertices.iter().flat_map(|point| point.iter().copied()).collect()
    }

    fn stl() -> Vec<u8> {
        let mut stl = vec![0; 84];
        stl[80] = 1;
        let triangle: [f32; 12] = [0.0, 0.0, 1.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0];
        stl.extend(triangle.iter().flat_map(|x| x.to_le_bytes()));
        stl.extend([0, 0]);
        stl
    }

    #[test]
    fn meshes_are_read_as_stl_and_obj() {
        let nine: Vec<f64> = (1..10).map(f64::from).collect();
        let text =
            "solid\nfacet normal 0 0 1\nouter loop\nvertex 1 2 3\nvertex 4 5 6\nvertex 7 8 9\nendloop\nendfacet\n";
        for bytes in [&stl()[..], b"v 1 2 3\nvn 0 0 1\nv 4 5 6\nv 7 8 9 1 1 1\nf 1 2 3\n", text.as_bytes()] {
            let read = read(bytes).unwrap();
            assert_eq!((points(&read), read.faces), (nine.clone(), vec![[0, 1, 2]]));
        }
        let quad = read(b"v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1/1/1 2/2 3 -1\n").unwrap();
        assert_eq!(quad.faces, [[0, 1, 2], [0, 2, 3]]);
        // Vertices without faces are a cloud of points, whose hull a robot's model may use.
        assert_eq!(read(b"v 1 2 3\n").unwrap().faces.len(), 0);
    }

    /// The notch of an L is not covered by a triangle.
    #[test]
    fn polygons_with_notches_are_divided() {
        let corners = "v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0\n";
        for first in 0..6 {
            let face: Vec<String> = (0..6).map(|corner| ((first + corner) % 6 + 1).to_string()).collect();
            let read = read(format!("{corners}f {}\n", face.join(" ")).as_bytes()).unwrap();
            let area = |[a, b, c]: &[u32; 3]| {
                let at = |of: &u32| read.vertices[*of as usize];
                0.5 * (at(b) - at(a)).cross(&(at(c) - at(a))).z
            };
            assert_eq!(read.faces.len(), 4, "{first}");
            assert!(read.faces.iter().all(|face| area(face) > 0.0), "{first}: {:?}", read.faces);
            assert_eq!(read.faces.iter().map(area).sum::<f64>(), 3.0, "{first}");
        }
    }

    #[test]
    fn broken_files_are_refused_with_their_line() {
        let mut short = stl();
        short.extend([0xff, 0xfe]);
        for (bytes, message) in [
            (&b"v 1 2 3\nf 1 0 1\n"[..], "line 2: the face names the vertex `0`"),
            (b"v 1 2 3\nf 1 1 2\nv 1 2 3\n", "line 2: the face names the vertex `2`. Expected one of the 1 vertices"),
            (b"v 1 2\n", "line 1: a vertex has 2 numbers. Expected three"),
            (b"v 1 2 nan\n", "line 1: `nan` is not a number"),
            (b"\nv 1 2 x\n", "line 2: `x` is not a number"),
            (b"v 1 2 3\nf 1 1\n", "line 2: a face has 2 corners"),
            (b"vertex 1 2 3\n", "the last facet has not three vertices"),
            (b"", "neither STL nor OBJ"),
            (b"hello\n", "neither STL nor OBJ"),
            (b"\xff\xfe", "neither STL nor OBJ"),
            (&short, "the 1 triangles that byte 80 states need 134"),
            (b"ply\nformat ascii 1.0\n", "a PLY file"),
            (b"<?xml version='1.0'?><COLLADA/>", "an XML file"),
            (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a pointer of Git LFS"),
        ] {
            let found = read(bytes).unwrap_err().to_string();
            assert!(found.contains(message), "{found}");
        }
        let many = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\n{}", "f 1 2 3\n".repeat(101));
        assert!(read(many.as_bytes()).unwrap_err().to_string().starts_with("line 104: it has more than 100 triangles"));
        let mut infinite = stl();
        infinite[96..100].copy_from_slice(&f32::INFINITY.to_le_bytes());
        assert!(read(&infinite).unwrap_err().what.contains("triangle 1 has a coordinate that is not finite"));
    }
}
