#include "palpate/scenes/guess/statistics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdlib>
#include <numeric>

#include <fmt/format.h>

namespace palpate::guess {

double percentile(const std::vector<float>& sorted, double percent) {
  if (sorted.empty()) return 0.0;
  const auto last = static_cast<double>(sorted.size() - 1);
  return sorted[static_cast<std::size_t>(std::lround(0.01 * percent * last))];
}

double rounded(double value, double range) {
  if (!(range > 0.0) || !std::isfinite(value)) return std::isfinite(value) ? value : 0.0;
  const double step = std::pow(10.0, std::floor(std::log10(range)) - 3.0);
  if (!(step > 0.0)) return value;
  const double near = std::round(value / step) * step + 0.0;  // turns -0 into 0
  return std::strtod(fmt::format("{:.12g}", near).c_str(), nullptr);
}

double entropyOf(const std::vector<float>& sorted) {
  const double low = percentile(sorted, 1.0);
  const double high = percentile(sorted, 99.0);
  if (!(high > low)) return 0.0;
  std::array<double, 64> bins{};
  for (const float value : sorted) {
    const double bin = std::floor((value - low) / (high - low) * 64.0);
    bins[static_cast<std::size_t>(std::clamp(bin, 0.0, 63.0))] += 1.0;
  }
  double entropy = 0.0;
  for (const double count : bins) {
    const double part = count / static_cast<double>(sorted.size());
    if (part > 0.0) entropy -= part * std::log(part);
  }
  return entropy / std::log(64.0);
}

double correlation(const std::vector<double>& a, const std::vector<double>& b) {
  const auto n = static_cast<double>(a.size());
  if (a.size() < 8) return 0.0;
  const double mean_a = std::accumulate(a.begin(), a.end(), 0.0) / n;
  const double mean_b = std::accumulate(b.begin(), b.end(), 0.0) / n;
  double aa = 0.0;
  double bb = 0.0;
  double ab = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    aa += (a[i] - mean_a) * (a[i] - mean_a);
    bb += (b[i] - mean_b) * (b[i] - mean_b);
    ab += (a[i] - mean_a) * (b[i] - mean_b);
  }
  return aa > 0.0 && bb > 0.0 ? std::abs(ab) / std::sqrt(aa * bb) : 0.0;
}

double proportionality(const std::vector<double>& a, const std::vector<double>& b) {
  const auto n = static_cast<double>(a.size());
  if (a.size() < 8) return 0.0;
  const double mean = std::accumulate(a.begin(), a.end(), 0.0) / n;
  double aa = 0.0;
  double bb = 0.0;
  double ab = 0.0;
  double all = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    all += (a[i] - mean) * (a[i] - mean);
    aa += a[i] * a[i];
    bb += b[i] * b[i];
    ab += a[i] * b[i];
  }
  if (!(all > 0.0 && bb > 0.0)) return 0.0;
  return std::sqrt(std::max(0.0, 1.0 - (aa - ab * ab / bb) / all));
}

}  // namespace palpate::guess
