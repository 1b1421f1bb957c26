#include "palpate/scenes/import/values.h"

#include <cmath>
#include <type_traits>

#include <tbb/blocked_range.h>
#include <tbb/parallel_for.h>
#include <vtkFloatArray.h>
#include <vtkSetGet.h>

#include "palpate/engine/error.h"

namespace palpate::importer {
namespace {

[[noreturn]] void refuse(vtkDataArray* values) {
  const char* name = values->GetName();
  throw VolumeError(name == nullptr ? "an array" : name, "its values are no numbers",
                    "export it as integers or floats");
}

template <class T>
const T* dataOf(vtkDataArray* values) {
  return static_cast<const T*>(values->GetVoidPointer(0));
}

/// Calls body(first, end) for parts of the tuples, in parallel.
template <class Body>
void forTuples(vtkIdType count, const Body& body) {
  tbb::parallel_for(
      tbb::blocked_range<vtkIdType>(0, count, 4096),
      [&](const tbb::blocked_range<vtkIdType>& part) { body(part.begin(), part.end()); });
}

template <class T>
void rescale(vtkDataArray* in, double slope, double offset, float* out) {
  const T* values = dataOf<T>(in);
  forTuples(in->GetNumberOfValues(), [&](vtkIdType first, vtkIdType end) {
    for (vtkIdType i = first; i < end; ++i) {
      out[i] = static_cast<float>(slope * static_cast<double>(values[i]) + offset);
    }
  });
}

template <class T>
void pick(vtkDataArray* in, const std::vector<int>& order, void* to) {
  const T* values = dataOf<T>(in);
  T* out = static_cast<T*>(to);
  const auto from = static_cast<vtkIdType>(in->GetNumberOfComponents());
  const auto width = static_cast<vtkIdType>(order.size());
  forTuples(in->GetNumberOfTuples(), [&](vtkIdType first, vtkIdType end) {
    for (vtkIdType i = first; i < end; ++i) {
      for (vtkIdType c = 0; c < width; ++c) {
        out[i * width + c] = values[i * from + order[static_cast<std::size_t>(c)]];
      }
    }
  });
}

template <class T>
void turnTuples(vtkDataArray* values, const Mat3& M) {
  T* data = static_cast<T*>(values->GetVoidPointer(0));
  const int width = values->GetNumberOfComponents();
  forTuples(values->GetNumberOfTuples(), [&](vtkIdType first, vtkIdType end) {
    for (vtkIdType i = first; i < end; ++i) {
      T* tuple = data + i * width;
      if (width == 3) {
        const Vec3 v = M * Vec3(tuple[0], tuple[1], tuple[2]);
        for (int c = 0; c < 3; ++c) tuple[c] = static_cast<T>(v[c]);
        continue;
      }
      double numbers[9] = {};
      for (int c = 0; c < width; ++c) numbers[c] = static_cast<double>(tuple[c]);
      const Mat3 D = M * tensorOf(numbers, width) * M.transpose();
      if (width == 6) {
        const double six[6] = {D(0, 0), D(1, 1), D(2, 2), D(0, 1), D(1, 2), D(0, 2)};
        for (int c = 0; c < 6; ++c) tuple[c] = static_cast<T>(six[c]);
      } else {
        for (int c = 0; c < 9; ++c) tuple[c] = static_cast<T>(D(c / 3, c % 3));
      }
    }
  });
}

}  // namespace

vtkSmartPointer<vtkDataArray> rescaled(vtkDataArray* values, double slope, double offset) {
  const bool none = slope == 0.0 || !std::isfinite(slope) || !std::isfinite(offset);
  if (none || (slope == 1.0 && offset == 0.0)) return values;
  auto out = vtkSmartPointer<vtkFloatArray>::New();
  out->SetName(values->GetName());
  out->SetNumberOfComponents(values->GetNumberOfComponents());
  out->SetNumberOfTuples(values->GetNumberOfTuples());
  switch (values->GetDataType()) {
    vtkTemplateMacro(rescale<VTK_TT>(values, slope, offset, out->GetPointer(0)));
    default:
      refuse(values);
  }
  return out;
}

vtkSmartPointer<vtkDataArray> picked(vtkDataArray* values, const std::vector<int>& order) {
  auto out =
      vtkSmartPointer<vtkDataArray>::Take(vtkDataArray::CreateDataArray(values->GetDataType()));
  out->SetName(values->GetName());
  out->SetNumberOfComponents(static_cast<int>(order.size()));
  out->SetNumberOfTuples(values->GetNumberOfTuples());
  switch (values->GetDataType()) {
    vtkTemplateMacro(pick<VTK_TT>(values, order, out->GetVoidPointer(0)));
    default:
      refuse(values);
  }
  return out;
}

vtkSmartPointer<vtkDataArray> turned(vtkDataArray* values, const Mat3& M) {
  if (M.isIdentity(0.0)) return values;
  vtkSmartPointer<vtkDataArray> out = values;
  const int type = values->GetDataType();
  if (type != VTK_FLOAT && type != VTK_DOUBLE) {
    out = vtkSmartPointer<vtkFloatArray>::New();
    out->SetName(values->GetName());
    out->DeepCopy(values);
  }
  if (out->GetDataType() == VTK_DOUBLE) {
    turnTuples<double>(out, M);
  } else {
    turnTuples<float>(out, M);
  }
  return out;
}

Mat3 tensorOf(const double* six_or_nine, int components) {
  const double* d = six_or_nine;
  Mat3 D;
  if (components == 6) {
    D << d[0], d[3], d[5], d[3], d[1], d[4], d[5], d[4], d[2];
  } else {
    D << d[0], d[1], d[2], d[3], d[4], d[5], d[6], d[7], d[8];
  }
  return D;
}

}  // namespace palpate::importer
