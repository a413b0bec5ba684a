// A detector of stars in C++ as a system under test: boresight hands over bare counts (raw16), a line of JSON a frame, and takes centroids back.
// It finds maxima above the noise and takes the centre of gravity around them. c++ -O2 -std=c++17 centroids.cpp -o centroids
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <vector>

// The value of a key of a line of JSON: enough for the flat lines of this protocol.
static std::string value(const std::string& line, const std::string& key) {
    auto at = line.find("\"" + key + "\":");
    if (at == std::string::npos) return "";
    at += key.size() + 3;
    if (line[at] == '"') return line.substr(at + 1, line.find('"', at + 1) - at - 1);
    return line.substr(at, line.find_first_of(",}", at) - at);
}

int main() {
    std::string line;
    while (std::getline(std::cin, line)) {
        const int width = std::stoi(value(line, "width_px")), height = std::stoi(value(line, "height_px"));
        std::vector<uint16_t> pixels(size_t(width) * height);
        std::ifstream file(value(line, "image"), std::ios::binary);
        if (!file.read(reinterpret_cast<char*>(pixels.data()), std::streamsize(2 * pixels.size()))) {
            std::cout << "{\"frame\":" << value(line, "frame") << ",\"status\":\"error\",\"error\":\"the image cannot be read\"}" << std::endl;
            continue;
        }
        auto sorted = pixels;
        auto quantile = [&](double share) {
            auto place = sorted.begin() + long(share * double(sorted.size() - 1));
            std::nth_element(sorted.begin(), place, sorted.end());
            return double(*place);
        };
        const double background = quantile(0.5), sigma = std::max(0.5, background - quantile(0.159));
        std::ostringstream stars;
        int count = 0;
        for (int y = 3; y < height - 3; ++y) {
            for (int x = 3; x < width - 3; ++x) {
                auto at = [&](int dx, int dy) { return double(pixels[size_t(y + dy) * width + (x + dx)]); };
                if (at(0, 0) < background + 5.0 * sigma) continue;
                bool largest = true;
                double sum = 0.0;
                for (int dy = -1; dy <= 1; ++dy)
                    for (int dx = -1; dx <= 1; ++dx) {
                        largest &= (dx == 0 && dy == 0) || at(dx, dy) < at(0, 0) || (at(dx, dy) == at(0, 0) && (dy > 0 || (dy == 0 && dx > 0)));
                        sum += at(dx, dy) - background;
                    }
                if (!largest || sum < 12.0 * sigma) continue;
                double flux = 0.0, mx = 0.0, my = 0.0;
                for (int dy = -2; dy <= 2; ++dy)
                    for (int dx = -2; dx <= 2; ++dx) {
                        const double light = std::max(0.0, at(dx, dy) - background);
                        flux += light;
                        mx += light * dx;
                        my += light * dy;
                    }
                stars << (count++ ? "," : "") << "[" << x + mx / flux << "," << y + my / flux << "," << flux << "]";
            }
        }
        std::cout << "{\"frame\":" << value(line, "frame") << ",\"status\":\"none\",\"centroids\":[" << stars.str() << "]}" << std::endl;
    }
}
